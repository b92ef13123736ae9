//! Writes a volume brick by brick, changes it, and reads both generations: `edit_bricks V.bvol`.
#![allow(clippy::print_stdout, reason = "a program")]
use brickmarch::query::statistics;
use brickmarch::store::{Volume, VolumeSpec, VolumeWriter};
use brickmarch::{Box3, Budget, Error, Grid, Result, SampleType};
use std::path::Path;

fn main() -> Result<()> {
    let Some(path) = std::env::args().nth(1) else {
        return Err(Error::bad_input("usage: edit_bricks V.bvol"));
    };
    let (path, budget) = (Path::new(&path), Budget::mib(32));
    // A billion samples, of which one brick is more than the background.
    let domain = Box3::from_size([1024; 3]);
    let spec = VolumeSpec {
        brick_edge: 32,
        ..VolumeSpec::new(Grid::new(domain), SampleType::U8)
    };
    let ramp: Vec<u8> = (0..32 * 32 * 32).map(|i| (i % 251) as u8).collect();
    let writer = VolumeWriter::create(path, &spec, &budget)?;
    writer.put_brick([3, 4, 5], &ramp)?;
    let first = writer.finish()?;
    println!("{}: {} bytes", path.display(), first.bytes_file);

    // A commit is there as a whole or not at all, whatever happens meanwhile.
    let writer = VolumeWriter::open(path, &budget)?;
    writer.put_brick([3, 4, 5], &[200; 32 * 32 * 32])?;
    let generation = writer.commit()?;
    let volume = Volume::open(path, &budget)?;
    let before = volume.open_generation(generation - 1)?;
    let brick = Box3::new([96, 128, 160], [128, 160, 192]);
    for (name, volume) in [("before", &before), ("after", &volume)] {
        println!(
            "{name}: mean {:.3}",
            statistics(volume, brick, &budget)?.mean
        );
    }
    Ok(())
}
