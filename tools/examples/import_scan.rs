//! Imports a scan and meshes it: `import_scan head.nii.gz head.bvol head.ply ISO`.
#![allow(clippy::print_stdout, reason = "a program")]
use brickmarch::iso::{Extract, extract};
use brickmarch::store::{Volume, VolumeSpec, import_stream};
use brickmarch::{Budget, Error, Result};
use brickmarch_formats::{OpenOptions, create_mesh_sink, open_volume};
use std::path::Path;

fn main() -> Result<()> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [scan, file, mesh, iso] = &args[..] else {
        return Err(Error::bad_input(
            "usage: import_scan SCAN OUT.bvol OUT.ply ISO",
        ));
    };
    let iso = iso
        .parse()
        .map_err(|_| Error::bad_input(format!("{iso}: no number")))?;
    let budget = Budget::mib(64);
    let mut source = open_volume(Path::new(scan), &OpenOptions::default())?;
    let mut spec = VolumeSpec::new(source.grid, source.sample);
    spec.kind = source.kind;
    let info = import_stream(&mut source.reader, &spec, Path::new(file), &budget)?;
    println!(
        "{file}: {} bytes for {} of samples",
        info.bytes_file, info.bytes_raw
    );
    let volume = Volume::open(Path::new(file), &budget)?;
    let options = Extract {
        iso,
        ..Extract::default()
    };
    let mut sink = create_mesh_sink(Path::new(mesh), true)?;
    let stats = extract(&volume, &options, &budget, &mut *sink)?;
    println!("{mesh}: {} triangles", stats.triangles);
    Ok(())
}
