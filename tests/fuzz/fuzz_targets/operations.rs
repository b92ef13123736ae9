//! Sequences of writes against a plain array: what was put comes out, in every way of asking.
#![no_main]
use brickmarch::store::{MemoryStorage, Volume, VolumeSpec, VolumeWriter, verify_in};
use brickmarch::{Box3, Budget, Field, Grid, Range, SampleType};
use libfuzzer_sys::fuzz_target;
use std::path::Path;
use std::sync::Arc;

const EDGE: usize = 8;

struct Bytes<'a>(&'a [u8]);

impl Bytes<'_> {
    fn next(&mut self) -> u8 {
        let Some((&first, rest)) = self.0.split_first() else {
            return 0;
        };
        self.0 = rest;
        first
    }
}

fuzz_target!(|data: &[u8]| {
    let mut input = Bytes(data);
    let sample = SampleType::ALL[usize::from(input.next()) % SampleType::ALL.len()];
    // More than eight bricks along x make a second level of pages.
    let size = [
        i32::from(input.next()) % 80 + 1,
        i32::from(input.next()) % 20 + 1,
        i32::from(input.next()) % 20 + 1,
    ];
    let min = [i32::from(input.next()) - 128, i32::MIN, i32::MAX - 40];
    let domain = Box3::new(min, std::array::from_fn(|a| min[a] + size[a]));
    let width = sample.bytes();
    let mut value = [0; 4];
    sample.put(f64::from(input.next() % 2), &mut value);
    let spec = VolumeSpec {
        brick_edge: EDGE as u32,
        background: sample.get(&value),
        name: format!("v{}", input.next()),
        ..VolumeSpec::new(Grid::new(domain), sample)
    };
    let budget = Budget::mib(16).with_threads(1);
    let storage = Arc::new(MemoryStorage::default());
    let name = Path::new("fuzzed");
    let writer =
        VolumeWriter::create_in(storage.clone(), name, &spec, &budget).expect("a good spec");
    let bricks = writer.bricks();
    let mut model: Vec<u8> = std::iter::repeat_n(&value[..width], domain.count() as usize)
        .flatten()
        .copied()
        .collect();
    let mut taken = vec![false; bricks.iter().product::<u32>() as usize];
    let set = |model: &mut Vec<u8>, brick: [u32; 3], raw: &dyn Fn(usize) -> [u8; 4]| {
        for n in 0..EDGE.pow(3) {
            let at = [n % EDGE, n / EDGE % EDGE, n / EDGE / EDGE];
            let p: [i64; 3] = std::array::from_fn(|a| {
                i64::from(min[a]) + (brick[a] as usize * EDGE + at[a]) as i64
            });
            if (0..3).all(|a| p[a] < i64::from(domain.max[a])) {
                let at = domain.offset_of(p.map(|v| v as i32)) * width;
                model[at..at + width].copy_from_slice(&raw(n)[..width]);
            }
        }
    };
    while !input.0.is_empty() {
        let brick: [u32; 3] = std::array::from_fn(|_| u32::from(input.next()) % 12);
        let inside = (0..3).all(|a| brick[a] < bricks[a]);
        let index = |b: [u32; 3]| (b[0] + bricks[0] * (b[1] + bricks[1] * b[2])) as usize;
        let how = input.next();
        let pattern = [input.next(), input.next(), input.next(), input.next()];
        if how % 4 == 3 {
            let level = how / 4 % 5;
            let mut bytes = pattern;
            if sample == SampleType::Bit {
                bytes = [bytes[0] & 1, 0, 0, 0];
            }
            bytes[width..].fill(0);
            let constant = sample.get(&bytes);
            let cube = 1u32 << level;
            let covered: Vec<[u32; 3]> = (0..cube.pow(3))
                .map(|n| {
                    [
                        brick[0] + n % cube,
                        brick[1] + n / cube % cube,
                        brick[2] + n / cube / cube,
                    ]
                })
                .filter(|b| (0..3).all(|a| b[a] < bricks[a]))
                .collect();
            // A second value for the same brick is the caller's error and ends the volume.
            if covered.iter().any(|&b| taken[index(b)]) {
                continue;
            }
            if writer.put_constant(brick, level, constant).is_ok() {
                assert!(inside);
                for b in covered {
                    taken[index(b)] = true;
                    // The value as the type stores it: a NaN may change its bits.
                    let mut stored = [0; 4];
                    sample.put(constant, &mut stored);
                    set(&mut model, b, &|_| stored);
                }
            }
            continue;
        }
        let raw = |n: usize| -> [u8; 4] {
            let mut bytes = pattern;
            match how % 4 {
                1 => bytes[0] = bytes[0].wrapping_add((n % EDGE) as u8),
                2 => bytes = (u32::from_le_bytes(pattern).wrapping_mul(n as u32 | 1)).to_le_bytes(),
                _ => {}
            }
            if sample == SampleType::Bit {
                [bytes[0] & 1, 0, 0, 0]
            } else {
                bytes
            }
        };
        let whole: Vec<u8> = (0..EDGE.pow(3))
            .flat_map(|n| raw(n)[..width].to_vec())
            .collect();
        if inside && taken[index(brick)] {
            continue;
        }
        let done = writer.put_brick(brick, &whole);
        assert_eq!(done.is_ok(), inside);
        if inside {
            taken[index(brick)] = true;
            set(&mut model, brick, &raw);
        }
    }
    let info = writer.finish().expect("memory does not fail");
    let volume = Volume::open_in(storage.clone(), name, &budget).expect("a finished volume");
    assert_eq!(volume.info().expect("info"), info);
    assert_eq!(volume.spec().name, spec.name);
    let mut out = vec![0; model.len()];
    volume.read_raw(domain, &mut out).expect("reads");
    assert!(out == model, "other samples");
    let mut values = vec![0.0; domain.count() as usize];
    sample.to_f32(&model, &mut values);
    let truth = Range::of_slice(&values);
    let said = volume.range(domain).expect("range");
    assert_eq!(truth.union(said), said, "the range is too narrow");
    let report = verify_in(storage, name, &budget).expect("verifies");
    assert!(report.is_intact(), "{report:?}");
});
