//! Values at points and what a ray meets: `probe V.bvol ISO`.
#![allow(clippy::print_stdout, reason = "a program")]
use brickmarch::query::{Cursor, Ray, Rays, Sampling, Space, sample_points};
use brickmarch::store::Volume;
use brickmarch::{Budget, Error, Field, Result};
use std::path::Path;

fn main() -> Result<()> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [path, iso] = &args[..] else {
        return Err(Error::bad_input("usage: probe V.bvol ISO"));
    };
    let iso = iso.parse().map_err(|_| Error::bad_input("no number"))?;
    let budget = Budget::mib(32);
    let volume = Volume::open(Path::new(path), &budget)?;
    let domain = volume.grid().domain;
    let at =
        |t: f64| [0, 1, 2].map(|a| f64::from(domain.min[a]) + t * f64::from(domain.size()[a] - 1));
    let points: Vec<_> = (0..=8).map(|i| at(f64::from(i) / 8.0)).collect();
    let options = Sampling {
        space: Space::Index,
        ..Sampling::default()
    };
    let mut values = vec![0.0; points.len()];
    sample_points(&volume, &points, &options, &mut values, &budget)?;
    println!("along the diagonal: {values:?}");
    let ray = Ray {
        origin: at(0.0),
        direction: [0, 1, 2].map(|a| at(1.0)[a] - at(0.0)[a]),
    };
    let rays = Rays::new(&volume, domain, &budget)?;
    let mut cursor = Cursor::new(&volume, &budget)?;
    match rays.first_crossing(&mut cursor, &ray, iso, 0.0)? {
        Some(hit) => println!("crosses {iso} at {:?}", ray.at(hit.t)),
        None => println!("does not cross {iso}"),
    }
    Ok(())
}
