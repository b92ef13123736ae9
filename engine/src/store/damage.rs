//! What a reader does about damage: an error, or a substitute and a list of what was substituted.

use super::page::PageRules;
use super::value::{KeyRange, bits_of_key, is_nan, key_of};
use super::verify::{MAX_PROBLEMS, Problem};
use crate::error::{Error, ErrorKind};
use crate::lattice::Box3;
use std::sync::{Mutex, PoisonError};

/// What reads do where the file is damaged.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum OnDamage {
    /// The read is an error that names the place.
    #[default]
    Error,
    /// The lost samples read as one value: the background, or where the index says that no sample
    /// there is as low or high, the nearest value that is; so ranges stay true. For looking at a
    /// damaged file, see [`Volume::substituted`](super::Volume::substituted).
    Substitute,
}

/// The policy, and what was substituted.
#[derive(Default)]
pub(super) struct Damage {
    pub(super) policy: OnDamage,
    found: Mutex<Vec<Problem>>,
}

impl Damage {
    pub(super) fn found(&self) -> Vec<Problem> {
        self.found
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .clone()
    }

    /// Notes that the samples of `lost` are substituted.
    ///
    /// # Errors
    /// `error`, when it is no damage or the policy is not to substitute.
    pub(super) fn substitute(&self, error: Error, lost: Box3) -> Result<(), Error> {
        if self.policy == OnDamage::Error || error.kind() != ErrorKind::Damaged {
            return Err(error);
        }
        let mut found = self.found.lock().unwrap_or_else(PoisonError::into_inner);
        if found.len() < MAX_PROBLEMS && !found.iter().any(|p| p.lost == Some(lost)) {
            found.push(Problem {
                message: error.to_string(),
                lost: Some(lost),
            });
        }
        Ok(())
    }
}

/// The bits in `range` that are nearest to the background.
pub(super) fn stand_in(rules: &PageRules, range: KeyRange) -> u32 {
    let (sample, background) = (rules.sample, rules.background);
    if range.is_empty() {
        return f32::NAN.to_bits();
    }
    if is_nan(sample, background) {
        return if range.has_nan {
            background
        } else {
            bits_of_key(sample, range.low)
        };
    }
    bits_of_key(
        sample,
        key_of(sample, background).clamp(range.low, range.high),
    )
}
