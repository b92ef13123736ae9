//! Real volumes of the shared data set: dimensions, value range and spacing as its README states.

use crate::export::{Export, export_volume};
use crate::testing::{samples, shared_volumes};
use crate::volume::{OpenOptions, open_volume};
use brickmarch::store::{Volume, import_stream};
use brickmarch::{Affine, Budget, ErrorKind, SampleType, Units};
use std::io::Read;
use std::path::Path;

struct Row {
    name: &'static str,
    dims: [u32; 3],
    sample: SampleType,
    range: [f64; 2],
    spacing: [f64; 3],
}

const fn row(
    name: &'static str,
    dims: [u32; 3],
    sample: SampleType,
    range: [f64; 2],
    spacing: [f64; 3],
) -> Row {
    Row {
        name,
        dims,
        sample,
        range,
        spacing,
    }
}

const CT: [f64; 3] = [0.78125, 0.78125, 1.0];
const ONE: [f64; 3] = [1.0; 3];

#[rustfmt::skip]
const TABLE: [Row; 13] = [
    row("ct_abdomen_512x512x275_u8.nrrd", [512, 512, 275], SampleType::U8, [0.0, 136.0], CT),
    row("bentheimer_500_binary.nrrd", [500; 3], SampleType::U8, [0.0, 1.0], ONE),
    row("em_labels_512_u32.nrrd", [512; 3], SampleType::U32, [0.0, 98_340_766.0], ONE),
    row("ch2.nii.gz", [181, 217, 181], SampleType::U8, [0.0, 254.0], ONE),
    row("aal.nii.gz", [181, 217, 181], SampleType::U8, [0.0, 116.0], ONE),
    row("embryo_256.mha", [256; 3], SampleType::U8, [0.0, 197.0], ONE),
    row("frogtissue.mhd", [500, 470, 136], SampleType::U8, [0.0, 29.0], [1.0, 1.0, 1.5]),
    row("HeadMRVolume.mhd", [48, 62, 42], SampleType::U8, [0.0, 255.0], [4.0; 3]),
    row("tooth.nhdr", [103, 94, 161], SampleType::U16, [0.0, 1300.0], ONE),
    row("someones_anatomy.nii.gz", [57, 67, 56], SampleType::F32, [6.678_363_8, 96.555_42], [2.75; 3]),
    row("ct_abdomen_crop128_i16.nrrd", [128; 3], SampleType::I16, [-1000.0, 1806.0], CT),
    row("stent_128x128x256_u8.nrrd", [128, 128, 256], SampleType::U8, [0.0, 32.0], ONE),
    row("example4d.nii.gz", [128, 96, 24], SampleType::I16, [0.0, 1162.0], [2.0, 2.0, 2.199_999_094]),
];

/// Smallest and largest value, and bytes read.
fn scan(reader: &mut dyn Read, sample: SampleType) -> std::io::Result<([f64; 2], u64)> {
    let mut buffer = vec![0; 1 << 20];
    let (mut range, mut total) = ([f64::INFINITY, f64::NEG_INFINITY], 0);
    loop {
        // Whole samples only.
        let mut filled = 0;
        while filled < buffer.len() {
            match reader.read(&mut buffer[filled..])? {
                0 => break,
                n => filled += n,
            }
        }
        if filled == 0 {
            return Ok((range, total));
        }
        total += filled as u64;
        for raw in buffer[..filled].chunks_exact(sample.bytes()) {
            let value = sample.get(raw);
            range = [range[0].min(value), range[1].max(value)];
        }
    }
}

#[test]
fn shared_volumes_are_as_their_table_says() {
    let Some(folder) = shared_volumes() else {
        return;
    };
    for row in &TABLE {
        let volumes = if row.name.contains("4d") { 2 } else { 1 };
        let mut range = [f64::INFINITY, f64::NEG_INFINITY];
        for volume in 0..volumes {
            let options = OpenOptions {
                volume: Some(volume),
                ..OpenOptions::default()
            };
            let mut source = open_volume(&folder.join(row.name), &options).expect(row.name);
            assert_eq!(source.grid.domain.size(), row.dims, "{}", row.name);
            assert_eq!(source.sample, row.sample, "{}", row.name);
            let spacing = source.grid.index_to_world.spacing();
            for (got, want) in spacing.iter().zip(row.spacing) {
                assert!((got - want).abs() < 1e-6, "{}: {spacing:?}", row.name);
            }
            let (found, bytes) = scan(&mut source.reader, source.sample).expect(row.name);
            let count: u64 = row.dims.iter().map(|&n| u64::from(n)).product();
            assert_eq!(bytes, count * row.sample.bytes() as u64, "{}", row.name);
            range = [range[0].min(found[0]), range[1].max(found[1])];
            assert!(source.late_notes().is_empty(), "{:?}", source.late_notes());
        }
        for (got, want) in range.iter().zip(row.range) {
            let near = (got - want).abs() <= 1e-6 * want.abs();
            assert!(near, "{}: {range:?}", row.name);
        }
    }
}

#[test]
fn shared_volumes_lie_where_their_headers_say() {
    let Some(folder) = shared_volumes() else {
        return;
    };
    let place = |name: &str, volume| {
        let options = OpenOptions {
            volume,
            ..OpenOptions::default()
        };
        open_volume(&folder.join(name), &options).expect(name).grid
    };
    let atlas = place("ch2.nii.gz", None);
    assert_eq!(
        atlas.index_to_world,
        Affine::from_spacing([1.0; 3], [-90.0, -125.0, -71.0])
    );
    assert_eq!(atlas.units, Units::Unknown);
    assert_eq!(
        place("someones_anatomy.nii.gz", None).units,
        Units::Millimetre
    );
    // Oblique, and x runs to the left: a left-handed map in RAS.
    let series = place("example4d.nii.gz", Some(1)).index_to_world;
    assert!(series.is_left_handed());
    assert_eq!(series.rows[0][0], -2.0);
    assert!((series.rows[1][2] + 0.355_528).abs() < 1e-6);
    let frog = place("frogtissue.mhd", None);
    assert_eq!(
        frog.index_to_world,
        Affine::from_spacing([1.0, 1.0, 1.5], [0.0; 3])
    );
}

#[test]
fn shared_volumes_that_are_no_volumes_say_why() {
    let Some(folder) = shared_volumes() else {
        return;
    };
    for (name, kind, say) in [
        ("nrrd_ascii_2.nrrd", ErrorKind::Unsupported, "has three"),
        ("nrrd_ascii_3.nrrd", ErrorKind::Unsupported, "has three"),
        ("nrrd_ascii_4.nrrd", ErrorKind::Unsupported, "has three"),
        ("example4d.nii.gz", ErrorKind::BadInput, "holds 2 volumes"),
        ("vase.vti", ErrorKind::Unsupported, "VTK"),
        ("img3d.tif", ErrorKind::Unsupported, "TIFF"),
        ("EMD-3001.map", ErrorKind::Unsupported, "MRC"),
        ("liver.inr.gz", ErrorKind::Unsupported, ".nrrd"),
        ("tooth.raw", ErrorKind::BadInput, "--dims"),
    ] {
        let error = open_volume(&folder.join(name), &OpenOptions::default())
            .err()
            .expect(name);
        assert_eq!(error.kind(), kind, "{error}");
        assert!(error.to_string().contains(say), "{error}");
        assert!(error.to_string().contains(name), "{error}");
    }
}

/// A scan in, a volume file, an NRRD out, and in again: the same samples at the same place.
#[test]
fn shared_volumes_survive_the_volume_file() {
    let Some(folder) = shared_volumes() else {
        return;
    };
    let budget = Budget::mib(32);
    for name in ["tooth.nhdr", "HeadMRVolume.mhd", "someones_anatomy.nii.gz"] {
        let scratch = tempfile::tempdir().expect("folder");
        let (stored, exported) = (scratch.path().join("v.bvol"), scratch.path().join("v.nrrd"));
        let open = |path: &Path| open_volume(path, &OpenOptions::default()).expect(name);
        let mut source = open(&folder.join(name));
        let spec = source.spec(16);
        import_stream(&mut source.reader, &spec, &stored, &budget).expect(name);
        let volume = Volume::open(&stored, &budget).expect(name);
        export_volume(&volume, None, &exported, &Export::default(), &budget).expect(name);
        let (mut first, mut again) = (open(&folder.join(name)), open(&exported));
        assert_eq!(again.grid, first.grid, "{name}");
        assert_eq!(
            (again.sample, again.kind, again.background),
            (first.sample, first.kind, first.background)
        );
        let same = samples(&mut again).expect(name) == samples(&mut first).expect(name);
        assert!(same, "{name}");
    }
}
