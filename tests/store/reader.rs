//! `tests/reader/read_bvol.py`, written from `docs/format.md` alone, against the engine: the same
//! samples and the same description of every file.

use super::{View, golden, handmade, read_all, small, views};
use crate::support::data::workspace;
use crate::support::program::Run;
use crate::support::python::{has, python};
use crate::support::rng::Rng;
use crate::support::scratch::{Scratch, bytes};
use brickmarch::store::{MemoryStorage, Storage};
use brickmarch::{Budget, SampleType};
use serde_json::{Value, json};
use std::path::PathBuf;
use std::sync::Arc;

fn run(scratch: &Scratch, file: &[u8], view: Option<&View>) -> Run {
    let script = workspace().join("tests/reader/read_bvol.py");
    let path = scratch.write("volume.bvol", file);
    let mut words = vec![script, path, scratch.path("samples.raw")];
    if let Some(view) = view {
        words.extend([PathBuf::from(&view.volume), view.level.to_string().into()]);
    }
    python(words)
}

/// JSON has no words for what is not finite; both sides say them as text.
fn same(said: &Value, value: f64) -> bool {
    match said.as_str() {
        Some(text) => text.eq_ignore_ascii_case(&value.to_string()),
        None => said.as_f64() == Some(value),
    }
}

/// The engine gives ranges as reads do, in f32.
fn same_f32(said: &Value, value: f32) -> bool {
    match said.as_f64() {
        Some(said) => said as f32 == value,
        None => same(said, f64::from(value)),
    }
}

/// Every volume and level of a file.
fn compare(scratch: &Scratch, name: &str, file: &[u8]) {
    let views = views(file, &Budget::mib(24)).expect("sound");
    for view in &views {
        compare_view(scratch, &view.key(name, &views[0].volume), file, view);
    }
}

fn compare_view(scratch: &Scratch, name: &str, file: &[u8], view: &View) {
    let storage: Arc<dyn Storage> = Arc::new(MemoryStorage::new(file.to_vec()));
    let volume = view.open(&storage, &Budget::mib(24)).expect("sound");
    // The first without being asked for it.
    let chosen = (view.level > 0 || volume.names()[0] != view.volume).then_some(view);
    let run = run(scratch, file, chosen).success();
    let samples = read_all(&volume).expect("sound");
    assert!(
        bytes(&scratch.path("samples.raw")) == samples,
        "{name}: the two readers see different samples"
    );
    let (said, spec, info) = (
        run.json(),
        volume.spec(),
        volume.info().expect("an open volume has info"),
    );
    let domain = spec.grid.domain;
    let matrix: Vec<f64> = spec
        .grid
        .index_to_world
        .rows
        .iter()
        .flatten()
        .copied()
        .collect();
    for (key, value) in [
        ("sample", json!(spec.sample.name())),
        ("kind", json!(spec.kind.name())),
        ("unit", json!(spec.grid.units.name())),
        ("brick_edge", json!(spec.brick_edge)),
        ("name", json!(spec.name)),
        ("history", json!(spec.history)),
        ("min", json!(domain.min)),
        ("size", json!(domain.size())),
        ("matrix", json!(matrix)),
        ("has_nan", json!(info.range.has_nan)),
        ("bricks", json!(info.bricks_stored)),
        ("tiles", json!(info.tiles)),
        ("pages", json!(info.pages)),
        ("generation", json!(info.generation)),
        ("volumes", json!(volume.names())),
    ] {
        assert_eq!(said[key], value, "{name}: {key}");
    }
    if view.level == 0 {
        assert_eq!(said["levels"], json!(volume.levels()), "{name}: levels");
    }
    assert!(
        same(&said["background"], spec.background),
        "{name}: background"
    );
    assert!(
        same_f32(&said["range"][0], info.range.min) && same_f32(&said["range"][1], info.range.max),
        "{name}: {} {:?}",
        said["range"],
        info.range
    );
}

#[test]
fn the_reader_from_the_document_agrees_with_the_engine() {
    if !has(&["numpy"], "the independent reader") {
        return;
    }
    let scratch = Scratch::new("reader");
    for (name, file) in golden::files() {
        compare(&scratch, &name, &file);
    }
    // More bricks of the codecs for floats, with values that no predictor likes.
    let odd = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, -0.0, f32::MAX];
    let mut rng = Rng::new(5);
    for mut small in small::all() {
        if small.spec.sample != SampleType::F32 {
            continue;
        }
        for round in 0..2 {
            for value in small.raw.as_chunks_mut::<4>().0 {
                if rng.chance(300) {
                    *value = rng.pick(&odd).to_le_bytes();
                }
            }
            compare(&scratch, &format!("{} {round}", small.name), &small.file());
        }
    }
    // The newest of several generations, and what a reader does without superblocks and header.
    for count in [2, 3] {
        let (file, _) = handmade::generations(count);
        compare(&scratch, "generations", &file);
        let mut lost = file.clone();
        lost[..12288].fill(0);
        compare(&scratch, "generations without a start", &lost);
    }
}

#[test]
fn the_reader_from_the_document_refuses_damage() {
    if !has(&["numpy"], "the independent reader") {
        return;
    }
    let scratch = Scratch::new("reader-damage");
    let (_, file) = golden::files().swap_remove(0);
    let begin = 12288 + 4136;
    let records = super::image::records(&file);
    let footer = records.last().expect("a footer").at;
    let mut rng = Rng::new(6);
    for _ in 0..20 {
        let at = begin + rng.below((footer - begin) as u64) as usize;
        let mut bad = file.clone();
        bad[at] ^= 1 << rng.below(8);
        let run = run(&scratch, &bad, None);
        assert_eq!(run.code, Some(1), "byte {at}: {run:#?}");
        assert!(run.stderr.lines().count() == 1, "byte {at}: {run:#?}");
    }
}
