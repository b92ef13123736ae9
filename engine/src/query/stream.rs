//! The bricks of a region, one after another, in bounded memory.

use super::blocks::{Block, Blocks, one_value};
use super::ordered::{AHEAD, in_order};
use crate::budget::{Budget, Permit};
use crate::error::{Error, Result};
use crate::field::{Field, Range, Samples};
use crate::lattice::Box3;

/// Samples of small blocks that one thread takes at a time.
const GROUP: u64 = 1 << 15;

/// A block of a region.
#[derive(Debug)]
pub struct Brick {
    /// The part of the block that lies in the region.
    pub region: Box3,
    /// Its samples.
    pub samples: BrickSamples,
    /// For the samples; given back when the brick is dropped.
    _permit: Option<Permit>,
}

/// The samples of a [`Brick`].
#[derive(Clone, Debug, PartialEq)]
pub enum BrickSamples {
    /// All have this value.
    Constant(f32),
    /// In lattice order, `i` fastest.
    Dense(Vec<f32>),
}

impl Brick {
    fn read(field: &dyn Field, block: Block, budget: &Budget) -> Result<Brick> {
        let region = block.region;
        if let Some(value) = one_value(&field.range(region)?) {
            return Ok(Brick {
                region,
                samples: BrickSamples::Constant(value),
                _permit: None,
            });
        }
        let permit = budget.take(region.count() * 4, "a brick of a region")?;
        let mut values = vec![0.0; region.count() as usize];
        field.read(region, &mut Samples::dense(&mut values, region))?;
        Ok(Brick {
            region,
            samples: BrickSamples::Dense(values),
            _permit: Some(permit),
        })
    }
}

/// An iterator over the bricks of a region in Morton order. Each is read when it is asked for, and
/// bricks of one value are not read at all. Bricks that the caller keeps stay under permit: when the
/// budget is used up, the next one is an error, and may be asked for again after some were dropped.
pub struct Bricks<'a> {
    field: &'a dyn Field,
    blocks: Blocks<'a, fn(&Range) -> bool>,
    /// Not read yet for want of memory.
    left: Option<Block>,
    budget: Budget,
}

impl<'a> Bricks<'a> {
    /// The bricks of `region`.
    ///
    /// # Errors
    /// When `region` is not inside the domain.
    pub fn new(field: &'a dyn Field, region: Box3, budget: &Budget) -> Result<Self> {
        check_region(field, region)?;
        let mut blocks: Blocks<'a, fn(&Range) -> bool> = Blocks::new(field, region, |_| true);
        blocks.unseen = true;
        Ok(Self {
            field,
            blocks,
            left: None,
            budget: budget.clone(),
        })
    }

    fn advance(&mut self) -> Result<Option<Brick>> {
        self.budget.check_cancelled()?;
        let block = match self.left.take() {
            Some(block) => Some(block),
            None => self.blocks.next()?,
        };
        let Some(block) = block else {
            return Ok(None);
        };
        let brick = Brick::read(self.field, block, &self.budget);
        if brick.is_err() {
            self.left = Some(block);
        }
        brick.map(Some)
    }
}

impl Iterator for Bricks<'_> {
    type Item = Result<Brick>;

    fn next(&mut self) -> Option<Result<Brick>> {
        self.advance().transpose()
    }
}

/// Hands the bricks of `region` to `take` in Morton order, on the calling thread, while the threads of
/// the budget read ahead by a few. A slow `take` slows them down; an error of it stops them.
///
/// # Errors
/// When `region` is not inside the domain, what the field and `take` report, `Cancelled`.
///
/// # Memory
/// At most three bricks of 32^3 samples a thread, or as many smaller ones, and a quarter of what is free,
/// beside those that `take` keeps.
pub fn bricks_of(
    field: &dyn Field,
    region: Box3,
    budget: &Budget,
    take: impl FnMut(Brick) -> Result<()>,
) -> Result<()> {
    check_region(field, region)?;
    let mut blocks = Blocks::new(field, region, |_: &Range| true);
    blocks.unseen = true;
    in_order(
        budget,
        ahead(field, budget),
        || blocks.next(),
        |block| Brick::read(field, block, budget),
        take,
    )
}

/// Results that the memory allows to wait.
pub(super) fn ahead(field: &dyn Field, budget: &Budget) -> usize {
    let samples = u64::from(field.block_edge()).pow(3);
    let room = (budget.free_bytes() / 4 / (samples * 4)) as usize;
    let group = (GROUP / samples).max(1) as usize;
    room.clamp(1, AHEAD * budget.threads() * group)
}

/// # Errors
/// When `region` is empty or not inside the domain.
pub(super) fn check_region(field: &dyn Field, region: Box3) -> Result<()> {
    let domain = field.grid().domain;
    if region.is_empty() || !domain.contains_box(&region) {
        return Err(Error::bad_input(format!(
            "region {region} is not inside the domain {domain}"
        )));
    }
    Ok(())
}
