//! Streams a region of a volume in bounded memory: `stream_region V.bvol X0 Y0 Z0 X1 Y1 Z1`.
#![allow(clippy::print_stdout, reason = "a program")]
use brickmarch::query::{BrickSamples, bricks_of};
use brickmarch::store::Volume;
use brickmarch::{Box3, Budget, Error, Result};
use std::path::Path;

fn main() -> Result<()> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let numbers: Vec<i32> = args.iter().skip(1).filter_map(|n| n.parse().ok()).collect();
    let &[x0, y0, z0, x1, y1, z1] = &numbers[..] else {
        return Err(Error::bad_input(
            "usage: stream_region V.bvol X0 Y0 Z0 X1 Y1 Z1",
        ));
    };
    let budget = Budget::mib(32);
    let volume = Volume::open(Path::new(&args[0]), &budget)?;
    let region = Box3::new([x0, y0, z0], [x1, y1, z1]);
    let (mut bricks, mut constant, mut sum) = (0, 0, 0.0);
    bricks_of(&volume, region, &budget, |brick| {
        bricks += 1;
        match brick.samples {
            BrickSamples::Constant(value) => {
                constant += 1;
                sum += f64::from(value) * brick.region.count() as f64;
            }
            BrickSamples::Dense(samples) => sum += samples.into_iter().map(f64::from).sum::<f64>(),
        }
        Ok(())
    })?;
    let mean = sum / region.count() as f64;
    println!("{bricks} bricks, {constant} of one value; mean {mean}");
    Ok(())
}
