//! Smallest and largest sample of every block of a raw file, and of every cube of 2^n blocks.

use super::{RawFile, Scratch};
use crate::budget::{Budget, Permit};
use crate::error::{Error, Result};
use crate::field::{Field, Range};
use crate::lattice::Box3;
use std::sync::{Mutex, PoisonError};

/// Samples converted at one time, on the stack.
const PIECE: usize = 2048;

pub(super) struct Ranges {
    domain: Box3,
    /// Samples per block edge, a power of two.
    edge: u64,
    /// Finest first; the last one has a single entry.
    levels: Vec<Level>,
    _permit: Permit,
}

struct Level {
    size: [u64; 3],
    ranges: Vec<Range>,
}

/// Blocks per axis, level by level.
fn level_sizes(samples: [u32; 3], edge: u64) -> Vec<[u64; 3]> {
    let mut sizes = vec![samples.map(|n| u64::from(n).div_ceil(edge))];
    while let Some(last) = sizes.last()
        && *last != [1; 3]
    {
        sizes.push(last.map(|n| n.div_ceil(2)));
    }
    sizes
}

fn table_bytes(samples: [u32; 3], edge: u64) -> u128 {
    let entries = |size: &[u64; 3]| size.iter().map(|&n| u128::from(n)).product::<u128>();
    let all: u128 = level_sizes(samples, edge).iter().map(entries).sum();
    all * size_of::<Range>() as u128
}

impl Ranges {
    /// Reads the whole file once, a slab of blocks per thread.
    pub(super) fn scan(file: &RawFile, budget: &Budget) -> Result<Self> {
        let domain = file.spec.grid.domain;
        let samples = domain.size();
        let mut edge = u64::from(file.block_edge());
        while table_bytes(samples, edge) > u128::from(budget.free_bytes() / 4)
            && samples.iter().any(|&n| u64::from(n) > edge)
        {
            edge *= 2;
        }
        let bytes = table_bytes(samples, edge);
        let bytes = u64::try_from(bytes).unwrap_or(u64::MAX);
        let permit = budget.take(bytes, "the table of block ranges")?;
        let mut levels: Vec<Level> = level_sizes(samples, edge)
            .into_iter()
            .map(|size| Level {
                size,
                ranges: vec![Range::EMPTY; size.iter().product::<u64>() as usize],
            })
            .collect();
        scan_blocks(file, budget, edge, &mut levels[0])?;
        for at in 1..levels.len() {
            let (below, above) = levels.split_at_mut(at);
            above[0].merge(&below[at - 1]);
        }
        Ok(Self {
            domain,
            edge,
            levels,
            _permit: permit,
        })
    }

    /// Range of all blocks that `region`, not empty and inside the domain, touches.
    pub(super) fn of(&self, region: Box3) -> Range {
        let block =
            |v: i32, a: usize| (i64::from(v) - i64::from(self.domain.min[a])) as u64 / self.edge;
        let low: [u64; 3] = std::array::from_fn(|a| block(region.min[a], a));
        let high: [u64; 3] = std::array::from_fn(|a| block(region.max[a] - 1, a) + 1);
        let mut range = Range::EMPTY;
        self.visit(self.levels.len() - 1, [0; 3], low, high, &mut range);
        range
    }

    /// Adds the part of a node that lies in the blocks `low..high`.
    fn visit(
        &self,
        level: usize,
        node: [u64; 3],
        low: [u64; 3],
        high: [u64; 3],
        range: &mut Range,
    ) {
        let first = node.map(|v| v << level);
        let last = node.map(|v| (v + 1) << level);
        if (0..3).any(|a| last[a] <= low[a] || high[a] <= first[a]) {
            return;
        }
        let Level { size, ranges } = &self.levels[level];
        // What sticks out of the table holds no samples.
        let inside = (0..3).all(|a| {
            let end = last[a].min(self.levels[0].size[a]);
            low[a] <= first[a] && end <= high[a]
        });
        if inside {
            let at = node[0] + size[0] * (node[1] + size[1] * node[2]);
            *range = union(*range, ranges[at as usize]);
            return;
        }
        let below = self.levels[level - 1].size;
        for child in 0..8u64 {
            let child = [
                2 * node[0] + (child & 1),
                2 * node[1] + (child >> 1 & 1),
                2 * node[2] + (child >> 2),
            ];
            if (0..3).all(|a| child[a] < below[a]) {
                self.visit(level - 1, child, low, high, range);
            }
        }
    }
}

impl Level {
    fn merge(&mut self, below: &Level) {
        let [nx, ny, _] = self.size;
        let mut from = below.ranges.iter();
        for z in 0..below.size[2] {
            for y in 0..below.size[1] {
                for x in 0..below.size[0] {
                    let range = from.next().expect("as many ranges as nodes");
                    let at = x / 2 + nx * (y / 2 + ny * (z / 2));
                    let node = &mut self.ranges[at as usize];
                    *node = union(*node, *range);
                }
            }
        }
    }
}

/// Ranges here sort -0 before +0, so that they do not depend on how a row was cut into pieces, and
/// one bit pattern at both ends means that all samples have it.
fn range_of(values: &[f32]) -> Range {
    let mut range = Range::of_slice(values);
    if range.min == 0.0 || range.max == 0.0 {
        let is = |zero: f32| values.iter().any(|v| v.to_bits() == zero.to_bits());
        if range.min == 0.0 {
            range.min = if is(-0.0) { -0.0 } else { 0.0 };
        }
        if range.max == 0.0 {
            range.max = if is(0.0) { 0.0 } else { -0.0 };
        }
    }
    range
}

fn union(a: Range, b: Range) -> Range {
    let first = |a: f32, b: f32| if b.total_cmp(&a).is_lt() { b } else { a };
    let last = |a: f32, b: f32| if b.total_cmp(&a).is_gt() { b } else { a };
    Range {
        min: first(a.min, b.min),
        max: last(a.max, b.max),
        has_nan: a.has_nan || b.has_nan,
    }
}

fn scan_blocks(file: &RawFile, budget: &Budget, edge: u64, table: &mut Level) -> Result<()> {
    let size = file.spec.grid.domain.size().map(u64::from);
    let width = file.spec.sample.bytes() as u64;
    let slice_bytes = size[0] * size[1] * width;
    budget.progress().start(slice_bytes * size[2]);
    let blocks = [table.size[0] as usize, table.size[1] as usize];
    let slabs = table.size[2] as usize;

    // The first buffer is needed, the others are welcome.
    let mut buffers = vec![Scratch::new(budget, super::READ_BYTES)?];
    while buffers.len() < budget.threads().min(slabs) {
        match Scratch::new(budget, super::READ_BYTES) {
            Ok(buffer) => buffers.push(buffer),
            Err(_) => break,
        }
    }
    let work = Mutex::new(table.ranges.chunks_mut(blocks[0] * blocks[1]).enumerate());
    let failure: Mutex<Option<(usize, Error)>> = Mutex::new(None);
    let run = |mut scratch: Scratch| {
        loop {
            let next = lock(&work).next();
            let Some((slab, ranges)) = next else { return };
            if lock(&failure).is_some() {
                return;
            }
            let first = slab as u64 * edge;
            let last = (first + edge).min(size[2]);
            let start = file.spec.offset + first * slice_bytes;
            let end = file.spec.offset + last * slice_bytes;
            let mut cursor = Cursor {
                size,
                edge,
                blocks,
                ranges,
                i: 0,
                j: 0,
            };
            let result = file.for_each_piece(start, end, &mut scratch.buffer, |raw| {
                budget.check_cancelled()?;
                cursor.add(file, raw);
                budget.progress().add(raw.len() as u64);
                Ok(())
            });
            if let Err(error) = result {
                let mut failure = lock(&failure);
                // The first in the file, so that the message does not depend on the threads.
                if failure.as_ref().is_none_or(|(at, _)| slab < *at) {
                    *failure = Some((slab, error));
                }
                return;
            }
        }
    };
    std::thread::scope(|scope| {
        let run = &run;
        let last = buffers.pop();
        for buffer in buffers {
            scope.spawn(move || run(buffer));
        }
        last.into_iter().for_each(run);
    });
    let failed = failure.into_inner().unwrap_or_else(PoisonError::into_inner);
    failed.map_or(Ok(()), |(_, error)| Err(error))
}

fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Place of the next sample of a slab of blocks.
struct Cursor<'a> {
    size: [u64; 3],
    edge: u64,
    blocks: [usize; 2],
    ranges: &'a mut [Range],
    i: u64,
    j: u64,
}

impl Cursor<'_> {
    /// Adds whole samples that follow those before.
    fn add(&mut self, file: &RawFile, mut raw: &[u8]) {
        let width = file.spec.sample.bytes();
        let mut values = [0f32; PIECE];
        while !raw.is_empty() {
            let row_rest = self.size[0] - self.i;
            let count = row_rest.min(PIECE as u64).min((raw.len() / width) as u64) as usize;
            let (now, rest) = raw.split_at(count * width);
            raw = rest;
            let values = &mut values[..count];
            file.convert(now, values);
            self.add_row(values);
            self.i += count as u64;
            if self.i == self.size[0] {
                self.i = 0;
                self.j = (self.j + 1) % self.size[1];
            }
        }
    }

    /// Adds a part of one row.
    fn add_row(&mut self, mut values: &[f32]) {
        let row = (self.j / self.edge) as usize * self.blocks[0];
        let mut i = self.i;
        while !values.is_empty() {
            let to_border = self.edge - i % self.edge;
            let count = to_border.min(values.len() as u64) as usize;
            let (now, rest) = values.split_at(count);
            let node = &mut self.ranges[row + (i / self.edge) as usize];
            *node = union(*node, range_of(now));
            values = rest;
            i += count as u64;
        }
    }
}
