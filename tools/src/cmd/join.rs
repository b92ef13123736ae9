//! `join`: the parts of a mesh into the mesh.

use super::{named, seconds, thousands};
use crate::Outcome;
use crate::args::Join;
use crate::job::Job;
use crate::output::{self, Replace};
use brickmarch::budget::human_bytes;
use brickmarch::iso::{join_parts, part_of};
use brickmarch::{Error, Result};
use serde_json::json;
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};

/// Bytes that are read of a part at one time.
const BUFFER: usize = 256 << 10;

pub(crate) fn run(args: &Join) -> anyhow::Result<Outcome> {
    let job = Job::new(&args.run);
    let replace = Replace::from(&args.overwrite);
    output::check_target(&args.out, replace)?;
    let paths = in_order(&args.parts)?;
    let mut sink = brickmarch_formats::create_mesh_sink(&args.out, replace == Replace::Yes)?;
    let stats = {
        let _watch = job.watch("joining");
        let mut files = Vec::new();
        for path in &paths {
            files.push(Part::Closed(path));
        }
        let mut parts: Vec<(&Path, &mut dyn Read)> = paths
            .iter()
            .zip(&mut files)
            .map(|(p, f)| (p.as_path(), f as &mut dyn Read))
            .collect();
        join_parts(&mut parts, args.allow_empty, &job.budget, sink.as_mut())
            .map_err(named(&[&args.out]))?
    };
    let bytes = std::fs::metadata(&args.out).map(|m| m.len()).unwrap_or(0);
    let text = format!(
        "{}: {} triangles, {} vertices from {} parts, {}, {}, peak {}\n",
        args.out.display(),
        thousands(stats.triangles),
        thousands(stats.vertices),
        paths.len(),
        human_bytes(bytes),
        seconds(job.seconds()),
        Job::peak_text(),
    );
    let mut json = json!({
        "schema": 1, "command": "join", "out": args.out, "parts": paths, "seconds": job.seconds(),
        "bytes_out": bytes, "peak_rss_bytes": crate::system::peak_resident_bytes(),
        "mem_bytes": args.run.limits.mem,
    });
    super::mesh::add_figures(&mut json, &stats, None);
    job.result(&text, &json)?;
    Ok(Outcome::Done)
}

/// The parts in their order, which they know themselves.
fn in_order(paths: &[PathBuf]) -> Result<Vec<PathBuf>> {
    let mut numbered = Vec::new();
    for path in paths {
        let mut file = File::open(path).map_err(|e| Error::io(path, "opening a part", e))?;
        numbered.push((part_of(path, &mut file)?.number, path.clone()));
    }
    numbered.sort();
    Ok(numbered.into_iter().map(|(_, path)| path).collect())
}

/// A part that is open only while it is read, so that there may be thousands.
enum Part<'a> {
    Closed(&'a Path),
    Open(BufReader<File>),
    Over,
}

impl Read for Part<'_> {
    fn read(&mut self, out: &mut [u8]) -> std::io::Result<usize> {
        if let Part::Closed(path) = self {
            *self = Part::Open(BufReader::with_capacity(BUFFER, File::open(path)?));
        }
        let Part::Open(file) = self else {
            return Ok(0);
        };
        let n = file.read(out)?;
        if n == 0 && !out.is_empty() {
            *self = Part::Over;
        }
        Ok(n)
    }
}
