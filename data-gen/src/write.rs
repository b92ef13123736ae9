//! Writing a scene to a file, which appears whole or not at all.

use crate::OutputArgs;
use anyhow::{Context, Result, bail};
use brickmarch::{Budget, SampleType};
use brickmarch_data_gen::{Sample, Scene, SceneField};
use std::ffi::OsString;
use std::fs::{self, File, OpenOptions};
use std::io::Write;
use std::path::{Path, PathBuf};

/// Bytes that are filled and written at one time when the budget allows.
const CHUNK_BYTES: u64 = 16 << 20;

/// Writes the scene by the extension of the output and returns the size of the file.
pub(crate) fn write(
    scene: Scene,
    sample: Sample,
    output: &OutputArgs,
    budget: &Budget,
) -> Result<u64> {
    let path = output.out.as_path();
    if path.exists() && !output.overwrite {
        bail!("{} exists: give --overwrite to replace it", path.display());
    }
    match path.extension().and_then(|e| e.to_str()) {
        Some("raw") => write_aside(path, |file| write_raw(&scene, sample, file, budget))?,
        Some("bvol") => write_volume(scene, sample, output, budget)?,
        _ => bail!(
            "{}: the extension says what is written: use .raw or .bvol",
            path.display()
        ),
    }
    let info = fs::metadata(path).with_context(|| path.display().to_string())?;
    Ok(info.len())
}

fn write_volume(scene: Scene, sample: Sample, output: &OutputArgs, budget: &Budget) -> Result<()> {
    let field = SceneField::new(scene);
    let mut spec = field.volume_spec();
    spec.sample = match sample {
        Sample::F32 => SampleType::F32,
        Sample::I16 => SampleType::I16,
    };
    if let Some(edge) = output.brick {
        spec.brick_edge = edge;
    }
    brickmarch::store::write_field(&field, &spec, &output.out, budget)?;
    Ok(())
}

/// Lets `fill` write a file beside `path`, syncs it and moves it to `path`.
fn write_aside(path: &Path, fill: impl FnOnce(&mut File) -> Result<()>) -> Result<()> {
    let aside = aside_of(path);
    let open = OpenOptions::new().write(true).create_new(true).open(&aside);
    let mut file = open.with_context(|| format!("creating {}", aside.display()))?;
    let done = fill(&mut file)
        .and_then(|()| file.sync_all().context("syncing"))
        .and_then(|()| fs::rename(&aside, path).context("renaming"))
        .with_context(|| format!("writing {}", path.display()));
    if done.is_err() {
        // The first error is the one to report.
        let _ = fs::remove_file(&aside);
    }
    done
}

fn aside_of(path: &Path) -> PathBuf {
    let mut name: OsString = path.as_os_str().to_owned();
    name.push(format!(".tmp-{}", std::process::id()));
    name.into()
}

/// Writes the samples in lattice order, chunk of rows by chunk of rows, each filled by all threads.
fn write_raw(scene: &Scene, sample: Sample, file: &mut File, budget: &Budget) -> Result<()> {
    let [nx, ny, nz] = scene.size();
    let sample_bytes = match sample {
        Sample::F32 => 4,
        Sample::I16 => 2,
    };
    let rows = u64::from(ny) * u64::from(nz);
    let row_bytes = u64::from(nx) * sample_bytes;
    // One row of values per thread, fewer threads when memory is short.
    let value_bytes = u64::from(nx) * 4;
    let fit = budget.free_bytes().saturating_sub(row_bytes) / (2 * value_bytes);
    let threads = (budget.threads() as u64).min(fit).max(1);
    let _values = budget.take(threads * value_bytes, "a row of values per thread")?;
    let chunk_bytes = CHUNK_BYTES.min(budget.free_bytes());
    let chunk_rows = (chunk_bytes / row_bytes).clamp(1, rows);
    let _chunk = budget.take(chunk_rows * row_bytes, "the rows that are written at once")?;
    let mut chunk = vec![0u8; (chunk_rows * row_bytes) as usize];
    let mut values = vec![0f32; threads as usize * nx as usize];
    let mut row = 0;
    while row < rows {
        budget.check_cancelled()?;
        let count = chunk_rows.min(rows - row);
        let part = &mut chunk[..(count * row_bytes) as usize];
        let share = count.div_ceil(threads);
        std::thread::scope(|scope| {
            let parts = part.chunks_mut((share * row_bytes) as usize);
            for (n, (part, values)) in parts.zip(values.chunks_mut(nx as usize)).enumerate() {
                let first = row + n as u64 * share;
                scope.spawn(move || fill_rows(scene, sample, first, row_bytes, values, part));
            }
        });
        file.write_all(part)?;
        row += count;
    }
    Ok(())
}

/// Fills `part` with the rows from `first` on, counted over all slices.
fn fill_rows(
    scene: &Scene,
    sample: Sample,
    first: u64,
    row_bytes: u64,
    values: &mut [f32],
    part: &mut [u8],
) {
    let ny = u64::from(scene.size()[1]);
    for (n, bytes) in part.chunks_mut(row_bytes as usize).enumerate() {
        let row = first + n as u64;
        scene.fill_row((row % ny) as u32, (row / ny) as u32, 0, values);
        match sample {
            Sample::F32 => {
                for (to, value) in bytes.chunks_exact_mut(4).zip(&*values) {
                    to.copy_from_slice(&value.to_le_bytes());
                }
            }
            Sample::I16 => {
                for (to, &value) in bytes.chunks_exact_mut(2).zip(&*values) {
                    to.copy_from_slice(&(value as i16).to_le_bytes());
                }
            }
        }
    }
}
