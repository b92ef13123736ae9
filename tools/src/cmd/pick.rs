//! From the command line to an open volume, and what is said of damage that was passed over.

use crate::Outcome;
use crate::args::{DamageMode, Pick};
use crate::job::Job;
use brickmarch::store::{OnDamage, Volume};
use brickmarch::{Budget, Result};
use std::path::Path;

/// Places of damage that are named one by one.
const SHOWN_MAX: usize = 20;

/// The volume, or level of detail of it, that was asked for.
///
/// # Errors
/// As [`Volume::open_named`] and [`Volume::level`].
pub(super) fn open(path: &Path, pick: &Pick, budget: &Budget) -> Result<Volume> {
    let mut volume = named(path, pick.name.as_deref(), budget)?;
    if pick.level > 0 {
        volume = volume.level(pick.level)?;
    }
    if pick.on_damage == DamageMode::Substitute {
        volume.set_on_damage(OnDamage::Substitute);
    }
    Ok(volume)
}

/// The volume of this name; the first where there is none.
///
/// # Errors
/// As [`Volume::open_named`].
pub(crate) fn named(path: &Path, name: Option<&str>, budget: &Budget) -> Result<Volume> {
    match name {
        Some(name) => Volume::open_named(path, name, budget),
        None => Volume::open(path, budget),
    }
}

/// What came of a command that has read `volume` and done the rest: says what was lost.
pub(super) fn outcome(volume: &Volume, path: &Path, job: &Job) -> Outcome {
    match report_substituted(volume, path, job) {
        true => Outcome::NotWhatWasAsked,
        false => Outcome::Done,
    }
}

/// Says what was lost; whether anything was.
pub(super) fn report_substituted(volume: &Volume, path: &Path, job: &Job) -> bool {
    let lost = volume.substituted();
    for problem in lost.iter().take(SHOWN_MAX) {
        let place = problem
            .lost
            .map_or(String::new(), |b| format!("; substituted: {b}"));
        job.note(&format!("{}{place}", problem.message));
    }
    if lost.len() > SHOWN_MAX {
        job.note(&format!(
            "{}: and {} more places: see `brickmarch verify`",
            path.display(),
            lost.len() - SHOWN_MAX
        ));
    }
    !lost.is_empty()
}
