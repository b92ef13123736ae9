//! `import`: a volume of another format into a volume file.

use super::{named, seconds, short};
use crate::Outcome;
use crate::args::{CompressionMode, Endian, Import};
use crate::job::Job;
use crate::output::{self, Replace};
use brickmarch::budget::human_bytes;
use brickmarch::store::{self, Compression, ImportOptions, VolumeInfo, VolumeSpec};
use brickmarch::{Budget, Grid, Result};
use brickmarch_formats::{OpenOptions, RawLayout, open_volume};
use serde_json::json;
use std::path::Path;

pub(crate) fn run(args: &Import) -> anyhow::Result<Outcome> {
    let job = Job::new(&args.run);
    let replace = Replace::from(&args.overwrite);
    let imported = {
        let _watch = job.watch("importing");
        import(args, replace, &job.budget)?
    };
    let Imported {
        info,
        grid,
        description,
        notes,
    } = imported;
    for note in &notes {
        job.note(&format!("note: {}: {note}", args.source.display()));
    }
    job.detail(&format!("{}: {description}", args.source.display()));
    let took = job.seconds();
    let speed = info.bytes_raw as f64 / 1e6 / took.max(1e-9);
    let spacing = grid.index_to_world.spacing();
    let size = grid.domain.size();
    let text = format!(
        "{}: {} x {} x {} {} {}, spacing {} x {} x {}{}, {} to {}: {} in {} ({:.2} times smaller), {} ({speed:.0} MB/s), peak {}\n",
        args.out.display(),
        size[0],
        size[1],
        size[2],
        info.sample.name(),
        info.kind.name(),
        short(spacing[0]),
        short(spacing[1]),
        short(spacing[2]),
        super::info::unit_text(&grid),
        info.range.min,
        info.range.max,
        human_bytes(info.bytes_raw),
        human_bytes(info.bytes_file),
        info.compression,
        seconds(took),
        Job::peak_text(),
    );
    let json = json!({
        "schema": 1, "command": "import", "source": args.source, "out": args.out,
        "description": description, "notes": notes, "volume": super::info::figures(&info, &grid),
        "bytes_out": info.bytes_file, "seconds": took, "mb_per_second": speed,
        "peak_rss_bytes": crate::system::peak_resident_bytes(),
    });
    job.result(&text, &json)?;
    Ok(Outcome::Done)
}

/// A finished import.
pub(super) struct Imported {
    pub info: VolumeInfo,
    pub grid: Grid,
    pub description: String,
    pub notes: Vec<String>,
}

fn import(args: &Import, replace: Replace, budget: &Budget) -> Result<Imported> {
    let raw = match (args.raw.dims, args.raw.sample) {
        (Some(dims), Some(sample)) => Some(RawLayout {
            dims,
            sample,
            big_endian: args.raw.endian == Endian::Big,
            spacing: args.raw.spacing.unwrap_or([1.0; 3]),
            offset: args.raw.offset,
        }),
        _ => None,
    };
    let options = OpenOptions {
        volume: args.volume,
        raw,
    };
    let change = |spec: &mut VolumeSpec| {
        if let Some(kind) = args.kind {
            spec.kind = kind;
        }
        if let Some(background) = args.background {
            spec.background = background;
        }
        if let Some(edge) = args.brick.as_ref().and_then(|b| b.parse().ok()) {
            spec.brick_edge = edge;
        }
    };
    let how = ImportOptions {
        resume: args.resume,
        levels: args.levels,
        compression: match args.compression {
            CompressionMode::Fast => Compression::Fast,
            CompressionMode::Small => Compression::Small,
        },
    };
    import_file(
        &args.source,
        &options,
        &args.out,
        replace,
        &change,
        &how,
        budget,
    )
}

/// Imports `source`; `change` has the last word on what the volume is.
///
/// # Errors
/// What the source, the volume file and the budget report.
pub(super) fn import_file(
    source: &Path,
    options: &OpenOptions,
    out: &Path,
    replace: Replace,
    change: &dyn Fn(&mut VolumeSpec),
    how: &ImportOptions,
    budget: &Budget,
) -> Result<Imported> {
    output::check_target(out, replace)?;
    if same_file(source, out) {
        return Err(brickmarch::Error::bad_input(format!(
            "{}: source and output are the same file",
            out.display()
        )));
    }
    let mut opened = open_volume(source, options)?;
    let mut spec = VolumeSpec::new(opened.grid, opened.sample);
    spec.kind = opened.kind;
    spec.background = opened.background;
    spec.history = format!(
        "imported from {}: {}",
        file_name(source),
        opened.description
    );
    spec.name = file_name(source);
    change(&mut spec);
    let info = match &opened.plain {
        Some(plain) => store::import_plain(&plain.file, plain.offset, &spec, out, how, budget),
        None => store::import_with(&mut opened.reader, &spec, out, how, budget),
    }
    .map_err(named(&[source, out]))?;
    let mut notes = opened.notes.clone();
    notes.extend(opened.late_notes());
    Ok(Imported {
        info,
        grid: spec.grid,
        description: opened.description,
        notes,
    })
}

/// The last part of a path, short enough for the file format.
fn file_name(path: &Path) -> String {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    name.chars().take(60).collect()
}

fn same_file(a: &Path, b: &Path) -> bool {
    match (a.canonicalize(), b.canonicalize()) {
        (Ok(a), Ok(b)) => a == b,
        _ => false,
    }
}
