use super::*;
use crate::lattice::Affine;
use proptest::prelude::*;
use std::io::Write;
use std::sync::atomic::Ordering::Relaxed;
use tempfile::NamedTempFile;

pub(super) fn scratch_file(bytes: &[u8]) -> NamedTempFile {
    let mut file = NamedTempFile::new().expect("scratch file");
    file.write_all(bytes).expect("writes");
    file
}

/// A file of `length` zeros that takes no room.
fn sparse_file(length: u64) -> NamedTempFile {
    let file = scratch_file(&[]);
    file.as_file().set_len(length).expect("grows");
    file
}

pub(super) fn read(field: &RawFile, region: Box3) -> Vec<f32> {
    let mut values = vec![f32::MIN; region.count() as usize];
    field
        .read(region, &mut Samples::dense(&mut values, region))
        .expect("reads");
    values
}

/// Every sample type in both byte orders, with content that looks different in each.
pub(super) fn specs() -> Vec<(RawSpec, Vec<u8>)> {
    let grid = Grid::new(Box3::new([-2, 7, 0], [3, 11, 3]));
    let mut all = Vec::new();
    for sample in SampleType::ALL {
        for (big_endian, offset) in [(false, 0), (true, 0), (false, 13), (true, 4097)] {
            let length = grid.domain.count() as usize * sample.bytes();
            let mut bytes = vec![0xee; offset];
            bytes.extend((0..length).map(|at| (at * 37 + at / 7 * 11) as u8));
            let spec = RawSpec {
                big_endian,
                offset: offset as u64,
                ..RawSpec::new(grid, sample, Kind::Density)
            };
            all.push((spec, bytes));
        }
    }
    all
}

/// One sample, the slow way.
fn oracle(spec: &RawSpec, bytes: &[u8], point: [i32; 3]) -> f32 {
    let width = spec.sample.bytes();
    let at = spec.offset as usize + spec.grid.domain.offset_of(point) * width;
    let mut raw = bytes[at..at + width].to_vec();
    if spec.big_endian {
        raw.reverse();
    }
    match spec.sample {
        SampleType::Bit => f32::from(raw[0] != 0),
        sample => sample.get(&raw) as f32,
    }
}

fn points(region: Box3) -> impl Iterator<Item = [i32; 3]> {
    let Box3 { min, max } = region;
    (min[2]..max[2]).flat_map(move |k| {
        (min[1]..max[1]).flat_map(move |j| (min[0]..max[0]).map(move |i| [i, j, k]))
    })
}

fn f32_file(size: [i32; 3], value: impl Fn(usize) -> f32) -> (NamedTempFile, RawSpec) {
    let spec = RawSpec::new(
        Grid::new(Box3::from_size(size)),
        SampleType::F32,
        Kind::Density,
    );
    let count = spec.grid.domain.count() as usize;
    let bytes: Vec<u8> = (0..count).flat_map(|at| value(at).to_le_bytes()).collect();
    (scratch_file(&bytes), spec)
}

fn reads(field: &RawFile) -> u64 {
    match &field.bytes {
        Bytes::File(file) => file.reads.load(Relaxed),
        Bytes::Map { .. } => panic!("a map is not read"),
    }
}

#[test]
fn every_type_order_and_box_agrees_with_the_slow_way() {
    for (spec, bytes) in specs() {
        let file = scratch_file(&bytes);
        let field = RawFile::open(file.path(), &spec, &Budget::mib(1)).expect("opens");
        let Box3 { min, max } = spec.grid.domain;
        let pairs =
            |a: usize| (min[a]..max[a]).flat_map(move |l| (l + 1..=max[a]).map(move |h| (l, h)));
        for (x, y) in pairs(0).flat_map(|x| pairs(1).map(move |y| (x, y))) {
            for z in pairs(2) {
                let region = Box3::new([x.0, y.0, z.0], [x.1, y.1, z.1]);
                let got = read(&field, region);
                let want = points(region).map(|p| oracle(&spec, &bytes, p));
                for (got, want) in got.iter().zip(want) {
                    assert_eq!(got.to_bits(), want.to_bits(), "{spec:?} {region}");
                }
            }
        }
    }
}

#[test]
fn close_rows_share_a_read_and_distant_ones_do_not() {
    let cases = [
        // Whole slices, 256 KiB in all: one read.
        ([64, 64, 64], SampleType::U8, [64, 64, 64], 1),
        // Gaps of 1.9 KiB between rows, 64 KiB between slices: a read per slice.
        ([512, 64, 64], SampleType::F32, [32, 32, 32], 32),
        // Gaps of 16 KiB: a read per row.
        ([4128, 8, 4], SampleType::F32, [32, 8, 4], 32),
        // The same gaps but whole rows: 15 rows of 16.5 KiB fit a buffer.
        ([4128, 8, 4], SampleType::F32, [4128, 8, 4], 3),
        // One row of 800 kB: four buffers.
        ([200_000, 1, 1], SampleType::F32, [200_000, 1, 1], 4),
    ];
    for (size, sample, region, expected) in cases {
        let grid = Grid::new(Box3::from_size(size));
        let spec = RawSpec::new(grid, sample, Kind::Density);
        let file = sparse_file(grid.domain.count() * sample.bytes() as u64);
        let field = RawFile::open(file.path(), &spec, &Budget::mib(1)).expect("opens");
        assert!(
            read(&field, Box3::from_size(region))
                .iter()
                .all(|&v| v == 0.0)
        );
        assert_eq!(reads(&field), expected, "{size:?} {region:?}");
    }
}

#[test]
fn strides_of_the_receiver_are_respected() {
    let (file, spec) = f32_file([4, 4, 4], |at| at as f32);
    let field = RawFile::open(file.path(), &spec, &Budget::mib(1)).expect("opens");
    let mut values = vec![-1.0; 200];
    let mut out = Samples {
        values: &mut values,
        row: 10,
        slice: 50,
    };
    let region = Box3::new([1, 1, 1], [4, 3, 3]);
    field.read(region, &mut out).expect("reads");
    assert_eq!(values[50..54], [37.0, 38.0, 39.0, -1.0]);
    assert_eq!(values[60..63], [41.0, 42.0, 43.0]);
    assert_eq!(values.iter().filter(|v| **v >= 0.0).count(), 12);
}

#[test]
fn a_small_budget_gives_the_same_samples_and_none_gives_an_error() {
    let (file, spec) = f32_file([3000, 5, 3], |at| at as f32);
    let whole = spec.grid.domain;
    let want: Vec<f32> = (0..whole.count()).map(|at| at as f32).collect();
    for bytes in [4 << 10, 5000, 70_000, 1 << 20] {
        let budget = Budget::bytes(bytes);
        let field = RawFile::open(file.path(), &spec, &budget).expect("opens");
        assert!(read(&field, whole) == want, "{bytes}");
        assert!(read(&field, whole) == want, "{bytes} again");
        assert!(budget.peak_bytes() <= bytes);
        drop(field);
        assert_eq!(budget.used_bytes(), 0);
    }
    let field = RawFile::open(file.path(), &spec, &Budget::bytes(4095)).expect("opens");
    let mut values = vec![0.0; whole.count() as usize];
    let refused = field.read(whole, &mut Samples::dense(&mut values, whole));
    assert_eq!(
        refused.expect_err("no room").kind(),
        ErrorKind::BudgetExceeded
    );
}

#[test]
fn threads_read_one_field() {
    let (file, spec) = f32_file([64, 32, 32], |at| at as f32);
    let budget = Budget::mib(8).with_threads(4);
    let field = RawFile::open(file.path(), &spec, &budget).expect("opens");
    std::thread::scope(|scope| {
        for thread in 0..8 {
            let (field, spec) = (&field, &spec);
            scope.spawn(move || {
                for k in 0..31 {
                    let k = (k * 5 + thread) % 31;
                    let region = Box3::new([8, 3, k], [40, 20, k + 2]);
                    let at = |p| spec.grid.domain.offset_of(p) as f32;
                    assert!(read(field, region).into_iter().eq(points(region).map(at)));
                }
            });
        }
    });
    assert!(field.idle().len() <= 4);
    assert!(budget.used_bytes() <= 4 * READ_BYTES as u64);
}

#[test]
fn every_wrong_length_is_refused_with_both_numbers() {
    for (spec, bytes) in specs() {
        let budget = Budget::mib(1);
        for length in (0..bytes.len()).step_by(11).chain([bytes.len() - 1]) {
            let file = scratch_file(&bytes[..length]);
            let error = RawFile::open(file.path(), &spec, &budget).expect_err("short");
            assert_eq!(error.kind(), ErrorKind::Truncated);
            let text = error.to_string();
            for part in [
                &format!("has {length} bytes"),
                &format!("make {}", bytes.len()),
                &*file.path().to_string_lossy(),
            ] {
                assert!(text.contains(part), "{part} in: {text}");
            }
        }
        let file = scratch_file(&[&bytes[..], b"x"].concat());
        let error = RawFile::open(file.path(), &spec, &budget).expect_err("long");
        assert_eq!(error.kind(), ErrorKind::BadInput);
        let spec = RawSpec {
            more_follows: true,
            ..spec
        };
        RawFile::open(file.path(), &spec, &budget).expect("may go on");
    }
}

#[test]
fn senseless_domains_are_refused() {
    let file = scratch_file(&[0; 64]);
    let open = |domain: Box3, offset: u64, sample| {
        let spec = RawSpec {
            offset,
            more_follows: true,
            ..RawSpec::new(Grid::new(domain), sample, Kind::Density)
        };
        RawFile::open(file.path(), &spec, &Budget::mib(1))
            .expect_err("senseless")
            .kind()
    };
    let all = Box3::new([i32::MIN; 3], [i32::MAX; 3]);
    for sample in SampleType::ALL {
        for empty in [[0, 4, 4], [4, 0, 4], [4, 4, 0], [0, 0, 0], [-1, 4, 4]] {
            assert_eq!(open(Box3::from_size(empty), 0, sample), ErrorKind::BadInput);
        }
        assert_eq!(open(all, 0, sample), ErrorKind::LimitExceeded);
        assert_eq!(open(all, u64::MAX, sample), ErrorKind::LimitExceeded);
        let one = Box3::from_size([1; 3]);
        assert_eq!(open(one, u64::MAX, sample), ErrorKind::LimitExceeded);
        assert_eq!(open(one, 64, sample), ErrorKind::Truncated);
        // 2^32 x 2^32 x 1: wraps to a small number in 64 bits with 4-byte samples.
        let wide = Box3::new([i32::MIN, i32::MIN, 0], [i32::MAX, i32::MAX, 1]);
        assert_ne!(open(wide, 0, sample), ErrorKind::BadInput);
        let exact = Box3::new([0; 3], [1 << 30, 1 << 30, 4]);
        assert_ne!(open(exact, 0, sample), ErrorKind::BadInput);
    }
    let mut spec = RawSpec::new(
        Grid::new(Box3::from_size([4; 3])),
        SampleType::U8,
        Kind::Mask,
    );
    spec.grid.index_to_world = Affine::from_spacing([1.0, 0.0, 1.0], [0.0; 3]);
    let error = RawFile::open(file.path(), &spec, &Budget::mib(1)).expect_err("flat");
    assert_eq!(error.kind(), ErrorKind::BadInput);
}

#[test]
fn missing_files_and_folders_are_refused_by_name() {
    let folder = tempfile::tempdir().expect("scratch folder");
    let spec = RawSpec::new(
        Grid::new(Box3::from_size([1; 3])),
        SampleType::U8,
        Kind::Mask,
    );
    let missing = folder.path().join("nothing.raw");
    let error = RawFile::open(&missing, &spec, &Budget::mib(1)).expect_err("missing");
    assert_eq!(error.kind(), ErrorKind::Io);
    assert!(error.to_string().contains("nothing.raw"));
    let error = RawFile::open(folder.path(), &spec, &Budget::mib(1)).expect_err("a folder");
    assert_eq!(error.kind(), ErrorKind::BadInput);
}

#[test]
fn a_file_cut_while_it_is_open_is_an_error_with_its_place() {
    let (file, spec) = f32_file([8, 8, 8], |at| at as f32);
    let budget = Budget::mib(1);
    let field = RawFile::open(file.path(), &spec, &budget).expect("opens");
    file.as_file().set_len(1030).expect("cuts");
    let low = Box3::from_size([8, 8, 4]);
    assert_eq!(read(&field, low)[255], 255.0);
    let high = Box3::new([0, 0, 4], [8, 8, 5]);
    let mut values = [0.0; 64];
    let error = field
        .read(high, &mut Samples::dense(&mut values, high))
        .expect_err("cut");
    assert_eq!(error.kind(), ErrorKind::Truncated);
    let text = error.to_string();
    assert!(
        text.contains("256 bytes of raw samples at byte 1024"),
        "{text}"
    );
    assert!(text.contains(&*file.path().to_string_lossy()), "{text}");
    let error = field.scan_ranges(&budget).expect_err("cut");
    assert_eq!(error.kind(), ErrorKind::Truncated);
    assert_eq!(field.range(low).expect("known"), Range::UNKNOWN);
}

#[test]
fn regions_outside_the_domain_are_refused() {
    let (file, spec) = f32_file([8, 8, 8], |at| at as f32);
    let field = RawFile::open(file.path(), &spec, &Budget::mib(1)).expect("opens");
    for region in [
        Box3::new([-1, 0, 0], [4, 4, 4]),
        Box3::new([0, 0, 0], [4, 9, 4]),
        Box3::new([0, 0, i32::MAX - 1], [1, 1, i32::MAX]),
    ] {
        let mut values = vec![0.0; region.count() as usize];
        let error = field
            .read(region, &mut Samples::dense(&mut values, region))
            .expect_err("outside");
        assert_eq!(error.kind(), ErrorKind::BadInput);
    }
    let nothing = Box3::new([3; 3], [3; 3]);
    field
        .read(nothing, &mut Samples::dense(&mut [], nothing))
        .expect("nothing to read");
    assert_eq!(field.range(nothing).expect("known"), Range::EMPTY);
}

#[test]
fn nan_and_infinity_come_through_and_nan_is_flagged() {
    let (file, spec) = f32_file([96, 40, 8], |at| match at {
        5 => f32::NAN,
        90 => f32::INFINITY,
        91 => f32::NEG_INFINITY,
        _ => 1.0,
    });
    let budget = Budget::mib(1);
    let field = RawFile::open(file.path(), &spec, &budget).expect("opens");
    let row = read(&field, Box3::from_size([96, 1, 1]));
    assert!(row[5].is_nan() && row[90] == f32::INFINITY && row[91] == f32::NEG_INFINITY);
    assert_eq!(
        field.range(spec.grid.domain).expect("known"),
        Range::UNKNOWN
    );
    field.scan_ranges(&budget).expect("scans");
    let range = |x: i32, y: i32| {
        let region = Box3::new([x, y, 0], [x + 1, y + 1, 1]);
        field.range(region).expect("known")
    };
    let nan = Range {
        has_nan: true,
        ..Range::of(1.0)
    };
    assert_eq!(range(0, 0), nan);
    assert_eq!(range(32, 0), Range::of(1.0));
    assert_eq!(
        range(95, 31),
        Range {
            min: f32::NEG_INFINITY,
            max: f32::INFINITY,
            has_nan: false
        }
    );
    assert_eq!(range(95, 32), Range::of(1.0));
    assert!(field.range(spec.grid.domain).expect("known").has_nan);
}

#[test]
fn ranges_tell_minus_zero_from_zero() {
    let (file, spec) = f32_file([128, 1, 1], |at| match at {
        0..32 => 0.0,
        32..64 => -0.0,
        64..96 if at % 2 == 0 => -0.0,
        _ => 0.0,
    });
    let budget = Budget::mib(1);
    let field = RawFile::open(file.path(), &spec, &budget).expect("opens");
    field.scan_ranges(&budget).expect("scans");
    let ends = |x: i32, to: i32| {
        let range = field
            .range(Box3::new([x, 0, 0], [to, 1, 1]))
            .expect("known");
        [range.min, range.max].map(f32::to_bits)
    };
    let (plus, minus) = (0f32.to_bits(), (-0f32).to_bits());
    assert_eq!(ends(0, 32), [plus, plus]);
    assert_eq!(ends(32, 64), [minus, minus]);
    assert_eq!(ends(64, 96), [minus, plus]);
    assert_eq!(ends(96, 128), [plus, plus]);
    assert_eq!(ends(0, 64), [minus, plus]);
    assert_eq!(ends(0, 128), [minus, plus]);
}

#[test]
fn scanning_stops_when_cancelled_and_may_be_done_again() {
    let (file, spec) = f32_file([40, 40, 40], |at| at as f32);
    let budget = Budget::mib(1);
    let field = RawFile::open(file.path(), &spec, &budget).expect("opens");
    let stopped = Budget::mib(1);
    stopped.cancel_token().cancel();
    let error = field.scan_ranges(&stopped).expect_err("cancelled");
    assert_eq!(error.kind(), ErrorKind::Cancelled);
    assert_eq!(stopped.used_bytes(), 0);
    field.scan_ranges(&budget).expect("scans");
    assert_eq!(budget.progress().get(), (256_000, 256_000));
    let max = field.range(spec.grid.domain).expect("known").max;
    assert_eq!(max, 63_999.0);
    let before = reads(&field);
    field.scan_ranges(&budget).expect("is done");
    assert_eq!(reads(&field), before);
}

#[test]
fn a_table_that_does_not_fit_gets_larger_blocks() {
    // 2 x 2 x 1024 blocks of 32: 49 kB and more.
    let spec = RawSpec::new(
        Grid::new(Box3::from_size([64, 64, 1 << 15])),
        SampleType::U8,
        Kind::Mask,
    );
    let file = sparse_file(spec.grid.domain.count());
    file.as_file()
        .try_clone()
        .and_then(|mut f| f.write_all(&[1]))
        .expect("writes");
    let budget = Budget::bytes(64 << 10).with_threads(2);
    let field = RawFile::open(file.path(), &spec, &budget).expect("opens");
    field.scan_ranges(&budget).expect("scans");
    assert!(budget.peak_bytes() <= 64 << 10);
    assert!((1..=16 << 10).contains(&budget.used_bytes()));
    let first = Box3::from_size([1; 3]);
    assert_eq!(field.range(first).expect("known").max, 1.0);
    let far = Box3::new([0, 0, 128], [64, 64, 1 << 15]);
    assert_eq!(field.range(far).expect("known"), Range::of(0.0));
    drop(field);
    assert_eq!(budget.used_bytes(), 0);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// The range of a box is that of the blocks it touches, for every shape and thread count.
    #[test]
    fn ranges_are_those_of_the_touched_blocks(
        size in prop::array::uniform3(1..90i32),
        corner in prop::array::uniform3(-50..50i32),
        seed in any::<u32>(),
        threads in 1..4usize,
        picks in prop::collection::vec(prop::array::uniform6(0.0..1.0f64), 8),
    ) {
        let domain = Box3::new(corner, std::array::from_fn(|a| corner[a] + size[a]));
        let value = |at: usize| ((at as u32).wrapping_mul(0x9e37_79b9) ^ seed) >> 8;
        let bytes: Vec<u8> = (0..domain.count() as usize)
            .flat_map(|at| (value(at) as u16).to_be_bytes())
            .collect();
        let file = scratch_file(&bytes);
        let spec = RawSpec {
            big_endian: true,
            ..RawSpec::new(Grid::new(domain), SampleType::U16, Kind::Density)
        };
        let budget = Budget::mib(4).with_threads(threads);
        let field = RawFile::open(file.path(), &spec, &budget).expect("opens");
        field.scan_ranges(&budget).expect("scans");
        for pick in picks {
            let ends: [(i32, i32); 3] = std::array::from_fn(|a| {
                let at = |t: f64| (t * f64::from(size[a])) as i32;
                let (p, q) = (at(pick[a]), at(pick[a + 3]));
                (corner[a] + p.min(q), corner[a] + p.max(q) + 1)
            });
            let region = Box3::new(ends.map(|e| e.0), ends.map(|e| e.1));
            let touched = Box3::new(
                std::array::from_fn(|a| corner[a] + (ends[a].0 - corner[a]) / 32 * 32),
                std::array::from_fn(|a| {
                    corner[a] + (((ends[a].1 - corner[a]) + 31) / 32 * 32).min(size[a])
                }),
            );
            let want = Range::of_slice(&read(&field, touched));
            prop_assert_eq!(field.range(region).expect("known"), want);
        }
    }
}
