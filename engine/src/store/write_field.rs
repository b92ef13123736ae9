//! Any field into a volume file: constant regions cost one question and become tiles at the highest
//! level.

use super::fill::{Bricks, Room, fill_with};
use super::spec::{VolumeInfo, VolumeSpec};
use super::value::bits_of;
use super::writer::VolumeWriter;
use crate::budget::Budget;
use crate::error::{Error, Result};
use crate::field::{Field, Range, Samples};
use crate::lattice::Box3;
use crate::sample::SampleType;
use std::path::Path;

/// Writes `field` over the domain of `spec` to a volume file at `out`.
///
/// Samples are converted to the type of the spec (saturating). Where [`Field::range`] says one value
/// and no NaN, nothing is evaluated. Bricks stand in Morton order; the bytes of the file do not
/// depend on the number of threads or on the budget.
///
/// # Errors
/// A domain that is not inside the field's, what the field reports, a write that fails. Nothing is
/// then left under `out`.
///
/// # Memory
/// Per thread about 1 MiB of encoded bricks and a few bricks; 32 bytes for each stored brick.
pub fn write_field(
    field: &dyn Field,
    spec: &VolumeSpec,
    out: &Path,
    budget: &Budget,
) -> Result<VolumeInfo> {
    write_fields(&[(field, spec)], out, budget)
}

/// Writes several fields as the volumes of one file, in this order, one commit for all; see
/// [`write_field`]. What it gives is of the first.
///
/// # Errors
/// As [`write_field`]; none to write, two of one name, too many.
///
/// # Memory
/// As [`write_field`], which is one volume after the other: only the 32 bytes of each stored brick add up.
pub fn write_fields(
    fields: &[(&dyn Field, &VolumeSpec)],
    out: &Path,
    budget: &Budget,
) -> Result<VolumeInfo> {
    for (field, spec) in fields {
        if !field.grid().domain.contains_box(&spec.grid.domain) {
            return Err(Error::bad_input(format!(
                "{}: the domain {} is not inside the field's {}",
                out.display(),
                spec.grid.domain,
                field.grid().domain
            )));
        }
    }
    let Some(((_, first), others)) = fields.split_first() else {
        return Err(Error::bad_input(format!(
            "{}: a file needs a volume: give at least one field",
            out.display()
        )));
    };
    let mut writer = VolumeWriter::create(out, first, budget)?;
    for (_, spec) in others {
        writer.add_volume(spec)?;
    }
    for (volume, (field, _)) in fields.iter().enumerate() {
        fill_with(&FieldBricks(*field), &writer, volume, budget)?;
    }
    writer.finish()
}

/// How many bricks [`write_field`] would evaluate: those whose range is not one value. The same questions, no
/// samples.
///
/// # Errors
/// What the field reports; when it is cancelled.
pub fn bricks_to_evaluate(field: &dyn Field, spec: &VolumeSpec, budget: &Budget) -> Result<u64> {
    let bricks = spec.bricks();
    let mut count = 0;
    let mut stack = vec![([0; 3], 1u32 << (3 * spec.root_level()))];
    while let Some((min, edge)) = stack.pop() {
        budget.check_cancelled()?;
        let outside = (0..3).any(|a| min[a] >= bricks[a]);
        if outside || constant(spec.sample, field.range(spec.node_box(min, edge))?).is_some() {
            continue;
        }
        if edge == 1 {
            count += 1;
            continue;
        }
        let half = edge / 2;
        stack.extend(
            (0..8u32)
                .map(|n| [0, 1, 2].map(|a| min[a] + (n >> a & 1) * half))
                .map(|min| (min, half)),
        );
    }
    Ok(count)
}

/// Puts every brick of `field` into the first volume of `writer`.
#[cfg(test)]
pub(super) fn fill(field: &dyn Field, writer: &VolumeWriter, budget: &Budget) -> Result<()> {
    fill_with(&FieldBricks(field), writer, 0, budget)
}

struct FieldBricks<'a>(&'a dyn Field);

impl Bricks for FieldBricks<'_> {
    fn constant(&self, spec: &VolumeSpec, region: Box3) -> Result<Option<u32>> {
        Ok(constant(spec.sample, self.0.range(region)?))
    }

    fn brick(
        &self,
        spec: &VolumeSpec,
        region: Box3,
        raw: &mut [u8],
        room: &mut Room,
    ) -> Result<()> {
        let edge = spec.brick_edge as usize;
        let mut block = Samples {
            values: &mut room.values,
            row: edge,
            slice: edge * edge,
        };
        self.0.read(region, &mut block)?;
        to_raw(spec.sample, &room.values, raw);
        Ok(())
    }

    fn room(&self, spec: &VolumeSpec) -> Room {
        Room {
            values: vec![0.0; (spec.brick_edge as usize).pow(3)],
            raw: Vec::new(),
        }
    }

    fn room_bytes(&self, spec: &VolumeSpec) -> u64 {
        u64::from(spec.brick_edge).pow(3) * 4
    }
}

/// The bits that every sample of this range gets, when it is one value. Conversion keeps the order
/// of values, so the ends decide.
fn constant(sample: SampleType, range: Range) -> Option<u32> {
    if range.has_nan || range.min > range.max {
        return None;
    }
    let [low, high] = [range.min, range.max].map(|v| bits_of(sample, f64::from(v)));
    (low == high).then_some(low)
}

/// Converts as [`SampleType::put`] does.
fn to_raw(sample: SampleType, values: &[f32], raw: &mut [u8]) {
    fn each<const N: usize>(values: &[f32], raw: &mut [u8], convert: impl Fn(f32) -> [u8; N]) {
        for (bytes, &value) in raw.as_chunks_mut::<N>().0.iter_mut().zip(values) {
            *bytes = convert(value);
        }
    }
    match sample {
        SampleType::F32 => each(values, raw, f32::to_le_bytes),
        SampleType::U8 => each(values, raw, |v| [v as u8]),
        SampleType::U16 => each(values, raw, |v| (v as u16).to_le_bytes()),
        SampleType::I16 => each(values, raw, |v| (v as i16).to_le_bytes()),
        SampleType::Bit => each(values, raw, |v| [u8::from(v >= 0.5)]),
        other => {
            for (bytes, &value) in raw.chunks_mut(other.bytes()).zip(values) {
                other.put(f64::from(value), bytes);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{Dense, mixed, open, spec};
    use super::super::{MemoryStorage, Volume};
    use super::*;
    use crate::field::FromFn;
    use crate::{ErrorKind, Grid, Kind};
    use std::sync::Arc;

    fn bytes_with(
        threads: usize,
        budget_mib: u64,
        field: &dyn Field,
        spec: &VolumeSpec,
    ) -> (Vec<u8>, VolumeInfo) {
        let budget = Budget::mib(budget_mib).with_threads(threads);
        let storage = Arc::new(MemoryStorage::default());
        let writer = VolumeWriter::create_in(storage.clone(), Path::new("test"), spec, &budget)
            .expect("good");
        fill(field, &writer, &budget).expect("fills");
        let info = writer.finish().expect("commits");
        assert_eq!(budget.used_bytes(), 0);
        (storage.to_vec(), info)
    }

    #[test]
    fn same_bytes_for_any_number_of_threads_and_any_budget() {
        for sample in [
            SampleType::Bit,
            SampleType::U8,
            SampleType::I16,
            SampleType::F32,
        ] {
            let spec = spec([100, 90, 70], sample, 16);
            let dense = Dense::new(spec.clone(), mixed);
            let at = |p: [i32; 3]| {
                let offset = spec.grid.domain.offset_of(p) * sample.bytes();
                sample.get(&dense.raw[offset..]) as f32
            };
            let field = FromFn::new(spec.grid, Kind::Density, at, |_| Range::UNKNOWN);
            let (one, info) = bytes_with(1, 24, &field, &spec);
            for (threads, mib) in [(2, 64), (8, 64), (8, 12)] {
                assert!(
                    bytes_with(threads, mib, &field, &spec) == (one.clone(), info.clone()),
                    "{sample:?} {threads}"
                );
            }
            let budget = Budget::mib(24);
            let volume = open(Arc::new(MemoryStorage::new(one)), &budget).expect("opens");
            dense.check(&volume, spec.grid.domain);
        }
    }

    #[test]
    fn constant_ranges_are_not_evaluated() {
        let domain = Box3::from_size([1024, 1024, 700]);
        let spec = VolumeSpec {
            brick_edge: 16,
            background: 0.0,
            ..VolumeSpec::new(Grid::new(domain), SampleType::F32)
        };
        let ball = |p: [i32; 3]| {
            p.iter()
                .map(|&v| (v as f32 - 300.0).powi(2))
                .sum::<f32>()
                .sqrt()
                - 100.0
        };
        let clamp = |v: f32| v.clamp(-3.0, 3.0);
        let range = |b: Box3| {
            let centre: [f32; 3] = std::array::from_fn(|a| (b.min[a] + b.max[a] - 1) as f32 / 2.0);
            let half: f32 = (0..3)
                .map(|a| ((b.max[a] - b.min[a]) as f32 / 2.0).powi(2))
                .sum::<f32>()
                .sqrt();
            let d = centre
                .iter()
                .map(|&v| (v - 300.0).powi(2))
                .sum::<f32>()
                .sqrt()
                - 100.0;
            Range {
                min: clamp(d - half - 0.01),
                max: clamp(d + half + 0.01),
                has_nan: false,
            }
        };
        let calls = std::sync::atomic::AtomicU64::new(0);
        let value = |p: [i32; 3]| {
            calls.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
            clamp(ball(p))
        };
        let field = FromFn::new(spec.grid, Kind::Distance, value, range);
        let expected = bricks_to_evaluate(&field, &spec, &Budget::mib(16)).expect("counts");
        assert_eq!(calls.load(std::sync::atomic::Ordering::Relaxed), 0);
        let (bytes, info) = bytes_with(2, 16, &field, &spec);
        assert!(
            expected >= info.bricks_stored && expected < 3500,
            "{expected}"
        );
        assert!(
            info.bricks_stored < 3000 && info.bricks_constant > 170_000,
            "{info:?}"
        );
        assert!(info.tiles < 10_000, "{}", info.tiles);
        let evaluated = calls.load(std::sync::atomic::Ordering::Relaxed);
        assert!(evaluated < 3500 * 4096, "{evaluated}");
        let volume: Volume =
            open(Arc::new(MemoryStorage::new(bytes)), &Budget::mib(24)).expect("opens");
        let region = Box3::new([190, 280, 290], [420, 310, 311]);
        let mut got = vec![0.0; region.count() as usize];
        volume
            .read(region, &mut Samples::dense(&mut got, region))
            .expect("reads");
        let mut want = vec![0.0; region.count() as usize];
        field
            .read(region, &mut Samples::dense(&mut want, region))
            .expect("reads");
        assert!(got == want);
    }

    #[test]
    fn errors_and_cancellation_stop_all_threads() {
        let folder = tempfile::tempdir().expect("scratch folder");
        let out = folder.path().join("x.bvol");
        let spec = spec([200, 200, 200], SampleType::F32, 16);
        let value = |p: [i32; 3]| p[0] as f32;
        let budget = Budget::mib(24).with_threads(4);
        let cancel = budget.cancel_token();
        let range = |b: Box3| {
            if b.min[2] > 200 {
                cancel.cancel();
            }
            Range::UNKNOWN
        };
        let field = FromFn::new(spec.grid, Kind::Density, value, range);
        let error = write_field(&field, &spec, &out, &budget).expect_err("cancelled");
        assert_eq!(error.kind(), ErrorKind::Cancelled);
        assert_eq!(std::fs::read_dir(folder.path()).expect("lists").count(), 0);
        let outside = VolumeSpec {
            grid: Grid::new(Box3::from_size([9; 3])),
            ..spec
        };
        assert_eq!(
            write_field(&field, &outside, &out, &budget)
                .expect_err("outside")
                .kind(),
            ErrorKind::BadInput
        );
    }
}
