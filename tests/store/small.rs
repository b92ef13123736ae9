//! Small volumes that together have every sample type, kind, codec and state of a slot.

use brickmarch::store::{Compression, MemoryStorage, VolumeSpec, VolumeWriter};
use brickmarch::{Affine, Box3, Budget, Grid, Kind, SampleType, Units};
use std::path::Path;
use std::sync::Arc;

/// A volume by name: what it is and its samples.
pub(crate) struct Small {
    pub(crate) name: &'static str,
    pub(crate) spec: VolumeSpec,
    pub(crate) raw: Vec<u8>,
}

fn hash(p: [u32; 3]) -> u32 {
    let mut h = p[0].wrapping_mul(0x9e37_79b1) ^ p[1].wrapping_mul(0x85eb_ca77);
    h ^= p[2].wrapping_mul(0xc2b2_ae3d);
    h = (h ^ h >> 15).wrapping_mul(0x2c1b_3c6d);
    (h ^ h >> 12).wrapping_mul(0x297a_2d39) ^ h >> 15
}

/// What the bricks along x hold, one after the other.
#[derive(Clone, Copy)]
pub(crate) enum Part {
    Background,
    Constant,
    Noise,
    Few,
    Ramp,
    Smooth,
    /// Noise in the lowest byte only.
    LowByte,
}

fn value(part: Part, sample: SampleType, p: [u32; 3]) -> f64 {
    let [x, y, z] = p.map(f64::from);
    let (low, scale) = match sample {
        SampleType::Bit => (0.0, 1.0),
        SampleType::U8 => (0.0, 255.0),
        SampleType::I8 => (-128.0, 255.0),
        SampleType::U16 => (0.0, 65535.0),
        SampleType::I16 => (-32768.0, 65535.0),
        SampleType::U32 => (0.0, 4294967295.0),
        SampleType::I32 => (-2147483648.0, 4294967295.0),
        SampleType::F32 => (-1e6, 2e6),
    };
    // Whole arithmetic and square roots only: the same on every machine.
    let unit = match part {
        Part::Background => return 0.0,
        Part::LowByte => return f64::from(0x1200 + hash(p) % 256),
        Part::Constant => 0.75,
        Part::Noise => f64::from(hash(p)) / 4294967295.0,
        Part::Few => f64::from(hash(p) % 29 / 28),
        Part::Ramp => (x + 2.0 * y + 3.0 * z) / 512.0,
        Part::Smooth => ((x - 11.0).powi(2) + (y - 5.0).powi(2) + z * z).sqrt() / 64.0,
    };
    let value = low + scale * unit;
    if sample == SampleType::F32 {
        value
    } else {
        value.round()
    }
}

pub(crate) fn make(
    name: &'static str,
    sample: SampleType,
    kind: Kind,
    parts: &[Part],
    change: impl FnOnce(&mut VolumeSpec, &mut Vec<u8>),
) -> Small {
    let size = [8 * parts.len() as i32 - 1, 8, 9];
    let min = [-5, 0, 1 << 20];
    let domain = Box3::new(min, std::array::from_fn(|a| min[a] + size[a]));
    let mut spec = VolumeSpec {
        kind,
        brick_edge: 8,
        name: name.into(),
        history: format!("golden file {name}"),
        ..VolumeSpec::new(Grid::new(domain), sample)
    };
    let mut raw = Vec::new();
    let mut bytes = vec![0; sample.bytes()];
    for n in 0..domain.count() as u32 {
        let [nx, ny] = [size[0] as u32, size[1] as u32];
        let p = [n % nx, n / nx % ny, n / nx / ny];
        let part = parts[p[0] as usize / 8];
        sample.put(value(part, sample, p), &mut bytes);
        raw.extend_from_slice(&bytes);
    }
    change(&mut spec, &mut raw);
    Small { name, spec, raw }
}

/// All of them, about 24 KiB a file.
pub(crate) fn all() -> Vec<Small> {
    use Part::{Background, Constant, Few, LowByte, Noise, Ramp, Smooth};
    use SampleType::{Bit, F32, I8, I16, I32, U8, U16, U32};
    let six = [Few, Background, Constant, Noise, Ramp, Smooth];
    let plain = |_: &mut VolumeSpec, _: &mut Vec<u8>| {};
    // Noise of many values, and of few that are rare.
    let noise = |spec: &VolumeSpec, raw: &mut [u8], value: fn(u32) -> u32| {
        for (n, sample) in raw.chunks_mut(spec.sample.bytes()).enumerate() {
            sample[0] = 90 + value(hash([n as u32, 5, 7]) >> 9) as u8;
            sample[1..].fill(3);
        }
    };
    let even = |spec: &mut VolumeSpec, raw: &mut Vec<u8>| noise(spec, raw, |h| h & 31);
    let rare = |spec: &mut VolumeSpec, raw: &mut Vec<u8>| {
        noise(spec, raw, |h| if h & 7 == 0 { 1 + (h >> 8 & 1) } else { 0 });
    };
    // A ball of one value in another.
    let two = |spec: &mut VolumeSpec, raw: &mut Vec<u8>| {
        let width = spec.sample.bytes();
        spec.brick_edge = 16;
        for sample in raw.chunks_mut(width) {
            let inside = sample[width - 1] < 50;
            sample.fill(if inside { 7 } else { 0x80 });
            sample[0] &= 0x0f;
        }
    };
    vec![
        make("bit_mask", Bit, Kind::Mask, &six, plain),
        make("u8_density", U8, Kind::Density, &six, plain),
        make("i8_density", I8, Kind::Density, &six, |spec, _| {
            spec.grid.index_to_world = Affine::from_spacing([0.5, 0.5, -2.0], [1.0, 2.0, 3.0]);
            spec.grid.units = Units::Millimetre;
        }),
        make("u16_color", U16, Kind::Color, &six, |spec, _| {
            spec.grid.units = Units::Nanometre;
        }),
        make("i16_density", I16, Kind::Density, &six, |spec, _| {
            spec.background = -1024.0;
            spec.history.clear();
        }),
        make("u32_label", U32, Kind::Label, &six[..5], |spec, _| {
            spec.name = "étiquettes".into();
        }),
        make("i32_label", I32, Kind::Label, &six[..5], |spec, _| {
            spec.background = -1.0;
        }),
        make("f32_distance", F32, Kind::Distance, &six[1..], |spec, _| {
            spec.grid.units = Units::Micrometre;
        }),
        make(
            "f32_nan",
            F32,
            Kind::Density,
            &[Smooth, Constant, Ramp],
            |spec, raw| {
                spec.background = f64::NAN;
                spec.grid.units = Units::Metre;
                let odd = [f32::NAN, f32::INFINITY, -0.0, f32::NEG_INFINITY, 1e-42];
                for (n, value) in raw.as_chunks_mut::<4>().0.iter_mut().enumerate() {
                    if n % 13 == 0 {
                        *value = odd[n / 13 % odd.len()].to_le_bytes();
                    }
                }
            },
        ),
        // Eleven bricks along x: two levels of pages, and a whole page of one value.
        make(
            "u8_two_levels",
            U8,
            Kind::Density,
            &[
                Constant, Constant, Constant, Constant, Constant, Constant, Constant, Constant,
                Ramp, Few, Background,
            ],
            plain,
        ),
        make("i32_planes", I32, Kind::Density, &[LowByte, Ramp], plain),
        make("u16_planes", U16, Kind::Density, &[LowByte, LowByte], plain),
        make(
            "u16_edge_16",
            U16,
            Kind::Density,
            &[Smooth, Smooth, Few],
            |spec, _| {
                spec.brick_edge = 16;
            },
        ),
        make(
            "u8_edge_32",
            U8,
            Kind::Density,
            &[Ramp, Smooth, Few],
            |spec, _| {
                spec.brick_edge = 32;
            },
        ),
        // A band between two clip values, with samples that no prediction meets.
        make(
            "f32_rows",
            F32,
            Kind::Distance,
            &[Smooth; 6],
            |spec, raw| {
                spec.brick_edge = 16;
                for (n, bytes) in raw.as_chunks_mut::<4>().0.iter_mut().enumerate() {
                    let band = f32::from_le_bytes(*bytes).clamp(-812_500.0, -500_000.0);
                    *bytes = match n % 1009 {
                        501 => f32::NAN.to_le_bytes(),
                        502 => (-0f32).to_le_bytes(),
                        _ => band.to_le_bytes(),
                    };
                }
            },
        ),
        // Noise, as scans have it.
        make("u8_fitted", U8, Kind::Density, &[Smooth, Ramp], even),
        make("i16_fitted", I16, Kind::Density, &[Smooth, Ramp], even),
        make("u8_coded", U8, Kind::Density, &[Smooth, Ramp], rare),
        make("i16_coded", I16, Kind::Density, &[Smooth, Ramp], rare),
        make("u8_two_values", U8, Kind::Density, &[Smooth; 6], two),
        make("i16_two_values", I16, Kind::Density, &[Smooth; 6], two),
        make("u32_two_values", U32, Kind::Label, &[Smooth; 6], two),
        make(
            "bit_two_values",
            Bit,
            Kind::Mask,
            &[Smooth; 9],
            |spec, _| {
                spec.brick_edge = 32;
            },
        ),
        make("bit_edge_64", Bit, Kind::Mask, &[Few, Noise], |spec, _| {
            spec.brick_edge = 64;
        }),
        make(
            "u8_all_background",
            U8,
            Kind::Density,
            &[Background],
            |spec, _| {
                spec.name.clear();
                spec.history.clear();
            },
        ),
    ]
}

impl Small {
    /// The volume as the current writer makes it.
    pub(crate) fn file(&self) -> Vec<u8> {
        let storage = Arc::new(MemoryStorage::default());
        let mut writer = VolumeWriter::create_in(
            storage.clone(),
            Path::new("small.bvol"),
            &self.spec,
            &Budget::mib(24).with_threads(1),
        )
        .expect("a good spec");
        if self.name.ends_with("coded") {
            writer.set_compression(Compression::Small);
        }
        let dense = crate::volume::Dense {
            spec: &self.spec,
            raw: &self.raw,
        };
        dense.put_all(&writer);
        writer.finish().expect("memory does not fail");
        storage.to_vec()
    }
}
