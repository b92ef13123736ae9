//! What cells cost whose signs leave the surface open: extraction from memory, one thread, of fields
//! with few such cells and with many. Run it in two checkouts to see what a change of their
//! treatment costs; the table in docs/benchmarks.md.

use crate::kernel::{Unranged, gyroid};
use brickmarch::field::Dense;
use brickmarch::iso::{Boundary, Extract, extract};
use brickmarch::mesh::Count;
use brickmarch::store::{Volume, VolumeSpec, import_stream};
use brickmarch::{Box3, Budget, Field, Grid, Samples};
use brickmarch_data_gen::Rng;
use std::path::PathBuf;
use std::time::Instant;

const RUNS: usize = 9;

pub(crate) fn run() {
    println!("| field | triangles | ambiguous faces | vertices in cells | ms |");
    println!("|---|---|---|---|---|");
    report("gyroid 256", 0.0, &gyroid(256, 32));
    for (name, iso) in [
        ("ct_abdomen_512x512x275_u8.nrrd", 31.5),
        ("ct_abdomen_crop128_i16.nrrd", 200.0),
        ("ch2.nii.gz", 49.5),
        ("embryo_256.mha", 65.0),
        ("bentheimer_500_binary.nrrd", 0.5),
    ] {
        match scan(name) {
            Some(field) => report(name, iso, &field),
            None => {
                println!("SKIPPED: {name}: set BRICKMARCH_DATA to the folder of the real scans")
            }
        }
    }
    report("white noise 128", 0.0, &noise(128));
}

fn noise(n: i32) -> Unranged {
    let mut rng = Rng::new(1);
    let domain = Box3::from_size([n; 3]);
    let values = (0..domain.count()).map(|_| rng.below(1 << 24) as f32 - 8_388_607.5);
    let mut field = Dense::new(Grid::new(domain), values.collect()).expect("right count");
    field.block_edge = 32;
    Unranged(field)
}

fn scan(name: &str) -> Option<Unranged> {
    let path = PathBuf::from(std::env::var_os("BRICKMARCH_DATA")?).join("volumes");
    let path = Some(path.join(name)).filter(|path| path.exists())?;
    let folder = tempfile::tempdir().expect("scratch folder");
    let stored = folder.path().join("scan.bvol");
    let source = brickmarch_formats::open_volume(&path, &Default::default()).expect("opens");
    let spec = VolumeSpec::new(source.grid, source.sample);
    let mut reader = source.reader;
    let budget = Budget::mib(64);
    import_stream(&mut reader, &spec, &stored, &budget).expect("imports");
    let volume = Volume::open(&stored, &budget).expect("opens");
    let domain = volume.grid().domain;
    let mut values = vec![0.0; domain.count() as usize];
    let mut out = Samples::dense(&mut values, domain);
    volume.read(domain, &mut out).expect("reads");
    let mut field = Dense::new(Grid::new(domain), values).expect("right count");
    field.block_edge = 32;
    Some(Unranged(field))
}

fn report(name: &str, iso: f32, field: &Unranged) {
    let options = Extract {
        iso,
        boundary: Boundary::Cut,
        ..Extract::default()
    };
    let mut best = f64::INFINITY;
    let mut stats = None;
    for _ in 0..RUNS {
        let budget = Budget::mib(256).with_threads(1);
        let start = Instant::now();
        let found = extract(field, &options, &budget, &mut Count::default()).expect("meshes");
        best = best.min(start.elapsed().as_secs_f64());
        stats = Some(found);
    }
    let stats = stats.expect("ran");
    println!(
        "| {name} | {} | {} | {} | {:.1} |",
        stats.triangles,
        stats.ambiguous_faces,
        stats.interior_vertices,
        best * 1e3
    );
}
