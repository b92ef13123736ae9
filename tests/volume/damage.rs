//! Damaged and foreign files: an error or the right samples, never a panic and never others.

use super::{file, raw_of, read_all};
use crate::support::fields::{Content, random};
use crate::support::rng::Rng;
use crate::support::scratch::{Scratch, bytes};
use brickmarch::store::{Volume, VolumeSpec};
use brickmarch::{Box3, Budget, Field, Grid, SampleType};
use brickmarch_data_gen::hostile::{Damage, flips, truncations};
use std::path::Path;

const DOMAIN: Box3 = Box3::from_size([20, 17, 40]);

fn sound(scratch: &Scratch) -> (Vec<u8>, Vec<u8>) {
    let mut rng = Rng::new(81);
    let mut values = random(Content::Smooth, DOMAIN, &mut rng);
    // Something constant, so that there are tiles.
    values[DOMAIN.offset_of([0, 0, 20])..].fill(2.5);
    let mut spec = VolumeSpec::new(Grid::new(DOMAIN), SampleType::F32);
    spec.brick_edge = 8;
    let path = file(scratch, "sound.bvol", &spec, &values);
    (bytes(&path), raw_of(SampleType::F32, &values))
}

/// Opens and reads everything; whatever comes out without an error must be right.
fn read(path: &Path, want: &[u8], what: &str) -> bool {
    let budget = Budget::mib(16);
    let read = Volume::open(path, &budget).and_then(|volume| {
        volume.range(DOMAIN)?;
        read_all(&volume, volume.grid().domain)
    });
    match read {
        Ok(got) => {
            assert!(got == want, "{what}: other samples came out, and no error");
            true
        }
        Err(error) => {
            let text = error.to_string();
            assert!(
                !text.contains('\n') && text.contains("damaged"),
                "{what}: {text}"
            );
            false
        }
    }
}

fn try_all(damages: impl Iterator<Item = Damage>) -> (usize, usize) {
    let scratch = Scratch::new("volume-damage");
    let (file, want) = sound(&scratch);
    let path = scratch.write("damaged.bvol", &file);
    assert!(read(&path, &want, "undamaged (the name only says so)"));
    let (mut all, mut survived) = (0, 0);
    for damage in damages {
        std::fs::write(&path, damage.applied(&file)).expect("scratch is writable");
        all += 1;
        survived += usize::from(read(&path, &want, &format!("{damage:?}")));
    }
    (all, survived)
}

fn length() -> usize {
    sound(&Scratch::new("volume-length")).0.len()
}

#[test]
fn volume_every_truncation() {
    let (all, survived) = try_all(truncations(
        length(),
        if cfg!(debug_assertions) { 200 } else { 1500 },
    ));
    assert!(
        all > 100 && survived <= 1,
        "{survived} of {all} truncated files read as if nothing had happened"
    );
}

#[test]
fn volume_bit_flips() {
    let (all, survived) = try_all(flips(
        length(),
        if cfg!(debug_assertions) { 300 } else { 2500 },
        5,
    ));
    // Unused and duplicate bytes may be flipped without harm; most bytes are needed.
    assert!(
        all > 100 && survived * 2 < all,
        "{survived} of {all} flips were not noticed"
    );
}

#[test]
fn volume_random_damage() {
    let mut rng = brickmarch_data_gen::Rng::new(9);
    let length = length();
    let rounds = if cfg!(debug_assertions) { 100 } else { 1000 };
    try_all((0..rounds).map(|_| Damage::random(length, &mut rng)));
}

#[test]
fn foreign_files_are_not_volumes() {
    let scratch = Scratch::new("volume-foreign");
    for (name, content) in [
        ("empty", vec![]),
        ("one byte", vec![0]),
        ("zeros", vec![0; 10_000]),
        ("text", b"ply\nformat ascii 1.0\n".repeat(100)),
        (
            "noise",
            (0..9999u32)
                .map(|v| (v.wrapping_mul(2_654_435_761) >> 24) as u8)
                .collect(),
        ),
    ] {
        let path = scratch.write("foreign.bvol", content);
        let error = Volume::open(&path, &Budget::mib(16))
            .err()
            .unwrap_or_else(|| panic!("{name} was opened"));
        assert!(
            error.to_string().contains("foreign.bvol"),
            "{name}: {error}"
        );
    }
}
