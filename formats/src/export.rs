//! Volumes out: raw samples, NumPy `.npy`, NRRD. Slab by slab within the budget, the file written
//! aside and named when it is whole.

use crate::aside::Aside;
use crate::limits::{bad, unsupported};
use crate::nrrd::{BACKGROUND_KEY, KIND_KEY, SAMPLE_KEY};
use crate::volume::{VOLUME_FORMATS, VolumeFormat, format_of_name};
use crate::world::space_of;
use brickmarch::store::{Volume, VolumeSpec};
use brickmarch::{Affine, Box3, Budget, Error, Kind, Result, SampleType, Units};
use flate2::Compression;
use flate2::write::GzEncoder;
use std::io::{BufWriter, Write};
use std::path::Path;

/// More than this at one time does not make an export faster.
const SLAB_BYTES_MAX: u64 = 16 << 20;

/// How to write a volume.
#[derive(Clone, Debug, Default)]
pub struct Export {
    /// `Raw`, `Npy` or `Nrrd`; `None` takes it from the name of the file.
    pub format: Option<VolumeFormat>,
    /// Compress the samples; NRRD only.
    pub gzip: bool,
    /// Replace a file of that name.
    pub overwrite: bool,
}

/// What was written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Exported {
    /// The format.
    pub format: VolumeFormat,
    /// The box that was written; its smallest point is sample 0, 0, 0 of the file.
    pub region: Box3,
    /// Type of the samples in the volume; a bit is written as a byte, 0 or 1.
    pub sample: SampleType,
    /// Length of the file.
    pub bytes: u64,
}

/// Writes the samples of `region`, by default the whole domain, to `path`. Samples keep their type,
/// little-endian, `i` fastest.
///
/// NRRD keeps the place in the world (of a region too), units, kind and background. The others keep
/// samples and, for `.npy`, the shape `(nz, ny, nx)`. Indices start at zero in all of them.
///
/// # Errors
/// `BadInput` for a region outside the domain, a name that says no format, or a file that exists;
/// `BudgetExceeded` when not even one row fits; what reading the volume reports. No file is left.
///
/// # Memory
/// One slab: at most half of the free budget and 16 MiB, at least one row of the region.
pub fn export_volume(
    volume: &Volume,
    region: Option<Box3>,
    path: &Path,
    options: &Export,
    budget: &Budget,
) -> Result<Exported> {
    let read = |part: Box3, out: &mut [u8]| volume.read_raw(part, out);
    export_samples(volume.spec(), &read, region, path, options, budget)
}

/// The file that [`export_volume`] writes, for who sends it elsewhere.
pub struct PlainParts {
    /// What stands before the samples.
    pub header: Vec<u8>,
    /// Bytes of all samples.
    pub sample_bytes: u64,
    /// Bytes of the largest part.
    pub part_bytes: u64,
    /// Boxes whose samples, one after the other, are those of the region.
    pub parts: Box<dyn Iterator<Item = Box3> + Send>,
}

/// The header of `format` and the parts of `region`, which must lie in the domain, each of at most
/// `bytes_max` bytes or one row.
pub fn plain_parts(
    spec: &VolumeSpec,
    region: Box3,
    format: VolumeFormat,
    bytes_max: u64,
) -> PlainParts {
    let slabs = Slabs::plan(spec, region, bytes_max);
    PlainParts {
        header: header_of(spec, region, format, false),
        sample_bytes: region.count() * spec.sample.bytes() as u64,
        part_bytes: slabs.bytes(),
        parts: Box::new(slabs.parts()),
    }
}

fn header_of(spec: &VolumeSpec, region: Box3, format: VolumeFormat, gzip: bool) -> Vec<u8> {
    match format {
        VolumeFormat::Npy => npy_header(spec.sample, region),
        VolumeFormat::Nrrd => nrrd_header(spec, region, gzip),
        _ => Vec::new(),
    }
}

type ReadRaw<'a> = &'a dyn Fn(Box3, &mut [u8]) -> Result<()>;

fn export_samples(
    spec: &VolumeSpec,
    read: ReadRaw<'_>,
    region: Option<Box3>,
    path: &Path,
    options: &Export,
    budget: &Budget,
) -> Result<Exported> {
    let domain = spec.grid.domain;
    let region = region.unwrap_or(domain);
    if region.is_empty() || !domain.contains_box(&region) {
        return Err(Error::bad_input(format!(
            "the region {region} is not inside the domain {domain}"
        )));
    }
    let format = format_of(path, options)?;
    let header = header_of(spec, region, format, options.gzip);
    let slabs = Slabs::plan(spec, region, budget.free_bytes() / 2);
    let _permit = budget.take(slabs.bytes(), "one slab of the export")?;
    let mut buffer = vec![0; slabs.bytes() as usize];

    let aside = Aside::create(path, options.overwrite)?;
    let writing = |e| Error::io(path, "writing", e);
    let mut file = aside.file();
    file.write_all(&header).map_err(writing)?;
    let mut copy = |out: &mut dyn Write| -> Result<()> {
        budget.progress().start(region.count());
        for part in slabs.parts() {
            budget.check_cancelled()?;
            let bytes = part.count() as usize * spec.sample.bytes();
            read(part, &mut buffer[..bytes])?;
            out.write_all(&buffer[..bytes]).map_err(writing)?;
            budget.progress().add(part.count());
        }
        Ok(())
    };
    if options.gzip {
        let mut packed = GzEncoder::new(BufWriter::new(file), Compression::default());
        copy(&mut packed)?;
        let mut plain = packed.finish().map_err(writing)?;
        plain.flush().map_err(writing)?;
    } else {
        copy(&mut file)?;
    }
    let bytes = file.metadata().map_err(writing)?.len();
    aside.commit()?;
    Ok(Exported {
        format,
        region,
        sample: spec.sample,
        bytes,
    })
}

fn format_of(path: &Path, options: &Export) -> Result<VolumeFormat> {
    let writable: Vec<String> = VOLUME_FORMATS
        .iter()
        .filter(|row| row.writes)
        .flat_map(|row| row.extensions)
        // A detached header is not written.
        .filter(|&&ending| ending != "nhdr")
        .map(|ending| format!(".{ending}"))
        .collect();
    let writable = writable.join(" ");
    let Some(format) = options.format.or_else(|| format_of_name(path)) else {
        return Err(bad(
            path,
            format!("the name says no volume format: end it in one of {writable}"),
        ));
    };
    let row = VOLUME_FORMATS.iter().find(|row| row.format == format);
    if !row.is_some_and(|row| row.writes) {
        let name = row.map_or("this format", |row| row.name);
        return Err(unsupported(
            path,
            format!("{name} is not written; end the name in one of {writable}"),
        ));
    }
    let ends_in = |ending: &str| {
        path.extension()
            .is_some_and(|e| e.eq_ignore_ascii_case(ending))
    };
    if ends_in("nhdr") {
        return Err(unsupported(
            path,
            "a detached header is not written; end the name in .nrrd",
        ));
    }
    if ends_in("gz") || options.gzip && format != VolumeFormat::Nrrd {
        return Err(unsupported(
            path,
            "only NRRD is compressed, inside a file named .nrrd",
        ));
    }
    Ok(format)
}

/// How a region is cut so that each part is contiguous in the file and fits in memory.
struct Slabs {
    region: Box3,
    /// Rows and slices of a part. More than one slice only where the slices are whole.
    rows: u32,
    slices: u32,
    /// Distance of the start of the region from the lower border of its bricks, along k.
    lead: u32,
    width: u64,
}

impl Slabs {
    fn plan(spec: &VolumeSpec, region: Box3, bytes_max: u64) -> Slabs {
        let limit = bytes_max.min(SLAB_BYTES_MAX);
        let width = spec.sample.bytes() as u64;
        let [nx, ny, nz] = region.size();
        let row = u64::from(nx) * width;
        let slice = row * u64::from(ny);
        let edge = u64::from(spec.brick_edge.max(1));
        let fitting = |one: u64, most: u32| (limit / one).clamp(1, u64::from(most)) as u32;
        let (rows, slices) = if slice <= limit {
            (ny, fitting(slice, nz))
        } else {
            (fitting(row, ny), 1)
        };
        // Whole layers of bricks, where one fits: each brick is decoded once.
        let layers = u64::from(slices) / edge * edge;
        let start = i64::from(region.min[2]) - i64::from(spec.grid.domain.min[2]);
        Slabs {
            region,
            rows,
            slices: if layers > 0 { layers as u32 } else { slices },
            lead: if layers > 0 {
                (start.unsigned_abs() % edge) as u32
            } else {
                0
            },
            width,
        }
    }

    fn bytes(&self) -> u64 {
        let [nx, ..] = self.region.size().map(u64::from);
        nx * u64::from(self.rows) * u64::from(self.slices) * self.width
    }

    /// The parts in the order of the file.
    fn parts(&self) -> impl Iterator<Item = Box3> + use<> {
        let Box3 { min, max } = self.region;
        let (rows, slices) = (self.rows as i32, self.slices as i32);
        let mut k = min[2];
        let mut j = min[1];
        let mut first = slices - self.lead as i32;
        std::iter::from_fn(move || {
            if k >= max[2] {
                return None;
            }
            let above = k.saturating_add(first).min(max[2]);
            let beside = j.saturating_add(rows).min(max[1]);
            let part = Box3::new([min[0], j, k], [max[0], beside, above]);
            j = beside;
            if j >= max[1] {
                (j, k, first) = (min[1], above, slices);
            }
            Some(part)
        })
    }
}

/// Version 1.0, padded so that the samples start at a multiple of 64.
fn npy_header(sample: SampleType, region: Box3) -> Vec<u8> {
    let code = match sample {
        SampleType::Bit => "|b1",
        SampleType::U8 => "|u1",
        SampleType::I8 => "|i1",
        SampleType::U16 => "<u2",
        SampleType::I16 => "<i2",
        SampleType::U32 => "<u4",
        SampleType::I32 => "<i4",
        SampleType::F32 => "<f4",
    };
    let [nx, ny, nz] = region.size();
    let mut dict =
        format!("{{'descr': '{code}', 'fortran_order': False, 'shape': ({nz}, {ny}, {nx}), }}");
    let fixed = crate::npy::MAGIC.len() + 4;
    while !(fixed + dict.len() + 1).is_multiple_of(64) {
        dict.push(' ');
    }
    dict.push('\n');
    let mut header = crate::npy::MAGIC.to_vec();
    header.extend([1, 0]);
    header.extend((dict.len() as u16).to_le_bytes());
    header.extend(dict.bytes());
    header
}

fn nrrd_header(spec: &VolumeSpec, region: Box3, gzip: bool) -> Vec<u8> {
    let kind = match spec.sample {
        SampleType::Bit | SampleType::U8 => "uint8",
        SampleType::I8 => "int8",
        SampleType::U16 => "uint16",
        SampleType::I16 => "int16",
        SampleType::U32 => "uint32",
        SampleType::I32 => "int32",
        SampleType::F32 => "float",
    };
    let Affine { rows } = spec.grid.index_to_world;
    // {:?} is the shortest text that reads back as the same number.
    let vector = |v: [f64; 3]| format!("({:?},{:?},{:?})", v[0], v[1], v[2]);
    let columns = [0, 1, 2].map(|a| vector([rows[0][a], rows[1][a], rows[2][a]]));
    let origin = spec.grid.index_to_world.apply(region.min.map(f64::from));
    let unit = match spec.grid.units {
        Units::Unknown => "",
        known => known.name(),
    };
    let [nx, ny, nz] = region.size();
    let mut lines = vec![
        "NRRD0005".to_owned(),
        format!("type: {kind}"),
        "dimension: 3".to_owned(),
        match space_of(&spec.history) {
            Some(space) => format!("space: {space}"),
            None => "space dimension: 3".to_owned(),
        },
        format!("sizes: {nx} {ny} {nz}"),
        format!("space directions: {}", columns.join(" ")),
        "kinds: domain domain domain".to_owned(),
        "endian: little".to_owned(),
        format!("encoding: {}", if gzip { "gzip" } else { "raw" }),
        format!("space units: \"{unit}\" \"{unit}\" \"{unit}\""),
        format!("space origin: {}", vector(origin)),
    ];
    if spec.sample == SampleType::Bit {
        lines.push(format!("{SAMPLE_KEY}:=bit"));
    }
    if spec.kind != Kind::Density {
        lines.push(format!("{KIND_KEY}:={}", spec.kind.name()));
    }
    if spec.background != 0.0 {
        lines.push(format!("{BACKGROUND_KEY}:={:?}", spec.background));
    }
    let mut header = lines.join("\n").into_bytes();
    header.extend(b"\n\n");
    header
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::raw::RawLayout;
    use crate::testing::samples;
    use crate::volume::{OpenOptions, Source, open_volume};
    use brickmarch::store::VolumeWriter;
    use brickmarch::{ErrorKind, Grid};
    use std::path::PathBuf;

    /// A volume with a domain that starts below zero, mirrored and sheared, and its dense samples.
    struct Case {
        _folder: tempfile::TempDir,
        volume: Volume,
        folder: PathBuf,
        raw: Vec<u8>,
    }

    const DOMAIN: Box3 = Box3::new([-3, 5, 0], [20, 24, 21]);

    fn place() -> Affine {
        let columns = [[0.1, 0.0, 0.0], [0.0, -0.3, 1e-7], [0.0, 0.25, 1.0 / 3.0]];
        Affine::from_columns(columns, [-12.5, 1e20, 0.1])
    }

    fn value(sample: SampleType, n: usize) -> f64 {
        let noise = (n as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 32;
        match sample {
            SampleType::Bit => (noise & 1) as f64,
            SampleType::F32 => f64::from(noise as f32 * 1e-3 - 7.0),
            SampleType::I8 | SampleType::I16 | SampleType::I32 => noise as f64 - 2f64.powi(31),
            _ => noise as f64,
        }
    }

    fn case(sample: SampleType) -> Case {
        let holder = tempfile::tempdir().expect("folder");
        let folder = holder.path().to_owned();
        let mut spec = VolumeSpec::new(
            Grid {
                domain: DOMAIN,
                index_to_world: place(),
                units: Units::Micrometre,
            },
            sample,
        );
        spec.brick_edge = 8;
        spec.history = "made here; world is right-anterior-superior by sform".into();
        let width = sample.bytes();
        let mut raw = vec![0; DOMAIN.count() as usize * width];
        for (n, out) in raw.chunks_exact_mut(width).enumerate() {
            // Noise in every bit: samples wrap instead of saturating.
            let bits = value(sample, n) as i64 as u64;
            match sample {
                SampleType::F32 | SampleType::Bit => sample.put(value(sample, n), out),
                _ => out.copy_from_slice(&bits.to_le_bytes()[..width]),
            }
        }
        let budget = Budget::mib(64);
        let path = folder.join("v.bvol");
        let writer = VolumeWriter::create(&path, &spec, &budget).expect("creates");
        let [nx, ny, nz] = writer.bricks();
        for k in 0..nz {
            for j in 0..ny {
                for i in 0..nx {
                    let brick = [i, j, k];
                    let min: [i32; 3] =
                        std::array::from_fn(|a| DOMAIN.min[a] + brick[a] as i32 * 8);
                    let cube = Box3::new(min, min.map(|v| v + 8));
                    let inside = cube.intersect(&DOMAIN);
                    let mut block = vec![0; 512 * width];
                    let cut = crop(&raw, DOMAIN, inside, width);
                    for (n, value) in cut.chunks_exact(width).enumerate() {
                        let [sx, sy, _] = inside.size().map(|n| n as usize);
                        let at = n % sx + 8 * (n / sx % sy + 8 * (n / sx / sy));
                        block[at * width..][..width].copy_from_slice(value);
                    }
                    writer.put_brick(brick, &block).expect("writes");
                }
            }
        }
        writer.finish().expect("finishes");
        Case {
            volume: Volume::open(&path, &budget).expect("opens"),
            _folder: holder,
            folder,
            raw,
        }
    }

    /// The dense samples of `part` out of those of `whole`.
    fn crop(raw: &[u8], whole: Box3, part: Box3, width: usize) -> Vec<u8> {
        let mut out = Vec::new();
        for k in part.min[2]..part.max[2] {
            for j in part.min[1]..part.max[1] {
                let start = whole.offset_of([part.min[0], j, k]) * width;
                out.extend(&raw[start..start + part.size()[0] as usize * width]);
            }
        }
        out
    }

    fn reopen(path: &Path, layout: Option<RawLayout>) -> Source {
        let options = OpenOptions {
            raw: layout,
            ..OpenOptions::default()
        };
        open_volume(path, &options).expect("opens")
    }

    const PARTS: [Option<Box3>; 3] = [
        None,
        Some(Box3::new([0, 6, 1], [17, 24, 20])),
        Some(Box3::new([19, 23, 20], [20, 24, 21])),
    ];

    #[test]
    fn export_round_trip_of_every_type() {
        for sample in SampleType::ALL {
            let case = case(sample);
            for part in PARTS {
                let region = part.unwrap_or(DOMAIN);
                let want = crop(&case.raw, DOMAIN, region, sample.bytes());
                for (name, gzip) in [
                    ("a.nrrd", false),
                    ("b.nrrd", true),
                    ("a.npy", false),
                    ("a.raw", false),
                ] {
                    let path = case.folder.join(name);
                    let options = Export {
                        gzip,
                        overwrite: true,
                        format: None,
                    };
                    let done = export_volume(&case.volume, part, &path, &options, &Budget::mib(8))
                        .expect(name);
                    assert_eq!(
                        done.bytes,
                        std::fs::metadata(&path).expect("is there").len()
                    );
                    let layout = RawLayout {
                        dims: region.size(),
                        sample,
                        ..RawLayout::default()
                    };
                    let mut source = reopen(&path, name.ends_with("raw").then_some(layout));
                    assert_eq!(source.sample, sample, "{name}");
                    assert_eq!(source.grid.domain.size(), region.size(), "{name}");
                    assert!(
                        samples(&mut source).expect(name) == want,
                        "{name} {sample:?}"
                    );
                    if name.ends_with("nrrd") {
                        assert_eq!(source.grid.units, Units::Micrometre);
                        let map = source.grid.index_to_world;
                        let origin = place().apply(region.min.map(f64::from));
                        for r in 0..3 {
                            assert_eq!(map.rows[r][..3], place().rows[r][..3]);
                            assert_eq!(map.rows[r][3], origin[r]);
                        }
                        assert!(source.description.contains("right-anterior-superior"));
                    }
                }
            }
        }
    }

    #[test]
    fn export_keeps_kind_and_background() {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("a.nrrd");
        let mut spec = VolumeSpec::new(Grid::new(Box3::from_size([2, 2, 2])), SampleType::I16);
        spec.kind = Kind::Label;
        spec.background = -1000.0;
        let fill = |_: Box3, out: &mut [u8]| {
            out.fill(1);
            Ok(())
        };
        let options = Export::default();
        export_samples(&spec, &fill, None, &path, &options, &Budget::mib(1)).expect("writes");
        let source = reopen(&path, None);
        assert_eq!((source.kind, source.background), (Kind::Label, -1000.0));
        assert_eq!(source.grid, spec.grid);
        let text = String::from_utf8_lossy(&std::fs::read(&path).expect("reads")).into_owned();
        std::fs::write(
            &path,
            text.replace("-1000.0", "1e99").replace("label", "lapel"),
        )
        .expect("writes");
        let source = reopen(&path, None);
        assert_eq!((source.kind, source.background), (Kind::Density, 0.0));
    }

    #[test]
    fn export_bytes_do_not_depend_on_the_budget() {
        let case = case(SampleType::U16);
        let path = case.folder.join("a.nrrd");
        let options = Export {
            overwrite: true,
            ..Export::default()
        };
        let mut first = None;
        // From one row at a time (46 bytes) to everything at once.
        for bytes in [92, 100, 1000, 2000, 14_000, 30_000, 1 << 20] {
            let budget = Budget::bytes(bytes);
            export_volume(&case.volume, None, &path, &options, &budget).expect("writes");
            assert!(budget.peak_bytes() <= bytes / 2);
            assert_eq!(budget.used_bytes(), 0);
            let found = std::fs::read(&path).expect("reads");
            assert!(found == *first.get_or_insert(found.clone()), "{bytes}");
        }
        let error = export_volume(&case.volume, None, &path, &options, &Budget::bytes(40))
            .expect_err("not one row");
        assert_eq!(error.kind(), ErrorKind::BudgetExceeded);
    }

    #[test]
    fn slabs_cover_the_region_in_order_and_follow_bricks() {
        let mut spec = VolumeSpec::new(Grid::new(DOMAIN), SampleType::U8);
        spec.brick_edge = 8;
        for limit in [1, 23, 60, 437, 1000, 4000, 8000, 1 << 20] {
            for part in PARTS {
                let region = part.unwrap_or(DOMAIN);
                let slabs = Slabs::plan(&spec, region, limit);
                let mut next = 0;
                for part in slabs.parts() {
                    assert!(!part.is_empty() && region.contains_box(&part));
                    assert!(part.count() <= slabs.bytes());
                    assert_eq!(region.offset_of(part.min), next, "{limit} {part}");
                    next += part.count() as usize;
                    let whole = part.size()[2] >= 8;
                    assert!(!whole || part.max[2] % 8 == 0 || part.max[2] == region.max[2]);
                }
                assert_eq!(next as u64, region.count());
                assert!(slabs.bytes() <= limit.max(u64::from(region.size()[0])));
            }
        }
    }

    #[test]
    fn export_refusals_leave_no_file() {
        let case = case(SampleType::Bit);
        let entries = || std::fs::read_dir(&case.folder).expect("folder").count();
        let before = entries();
        let export = |name: &str, part, options: &Export| {
            let path = case.folder.join(name);
            export_volume(&case.volume, part, &path, options, &Budget::mib(8))
                .expect_err(name)
                .to_string()
        };
        let plain = Export::default();
        for name in [
            "a",
            "a.txt",
            "a.nii",
            "a.mha",
            "a.nhdr",
            "a.npy.gz",
            "a.raw.gz",
            "a.nrrd.gz",
        ] {
            assert!(export(name, None, &plain).contains(name));
        }
        let gzip = Export {
            gzip: true,
            ..Export::default()
        };
        assert!(export("a.npy", None, &gzip).contains("only NRRD"));
        let outside = Box3::new([-4, 5, 0], [20, 24, 21]);
        assert!(export("a.raw", Some(outside), &plain).contains("not inside"));
        assert!(
            export("a.raw", Some(Box3::new([0, 6, 1], [0, 7, 2])), &plain).contains("not inside")
        );
        assert!(export("none/a.raw", None, &plain).contains("none"));
        // What the volume reports comes through, and nothing stays behind.
        let broken = |_: Box3, _: &mut [u8]| Err(Error::new(ErrorKind::Damaged, "a brick"));
        let path = case.folder.join("b.nrrd");
        let error = export_samples(
            case.volume.spec(),
            &broken,
            None,
            &path,
            &gzip,
            &Budget::mib(8),
        );
        assert_eq!(error.expect_err("broken").kind(), ErrorKind::Damaged);
        assert_eq!(entries(), before);
        let budget = Budget::mib(8);
        export_volume(&case.volume, None, &path, &plain, &budget).expect("writes");
        assert!(export("b.nrrd", None, &plain).contains("--overwrite"));
        budget.cancel_token().cancel();
        let late = case.folder.join("c.nrrd");
        let stopped =
            export_volume(&case.volume, None, &late, &plain, &budget).expect_err("cancelled");
        assert_eq!(stopped.kind(), ErrorKind::Cancelled);
        assert_eq!(entries(), before + 1);
    }
}
