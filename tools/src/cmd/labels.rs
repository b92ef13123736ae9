//! `mesh --labels`: the surfaces of many segments in one pass over the volume.

use super::mesh::{cells, keep, scratch_files};
use super::{named, pick, seconds, thousands};
use crate::Outcome;
use crate::args::{BoundaryMode, Mesh, Space};
use crate::colourmap;
use crate::job::Job;
use crate::output::{self, Replace};
use crate::parse::LabelList;
use crate::picture;
use crate::render::{Raster, WorldBox, look};
use crate::tally::{Figures, Tally};
use crate::tee::Tee;
use brickmarch::budget::human_bytes;
use brickmarch::field::Labels;
use brickmarch::iso::{Boundary, ExtractLabels, LabelStats, extract_labels, label_blocks};
use brickmarch::mesh::{Components, LabelSpool, Layout, MeshSink, Piece, Totals};
use brickmarch::{Box3, Error, ErrorKind, Result};
use brickmarch_formats as formats;
use glam::{DVec3, Vec3};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

/// What the number of the segment replaces in the name of the output.
const PLACE: &str = "{label}";

/// The mesh of a segment as it was written.
struct Written {
    label: u32,
    totals: Totals,
    /// Its own file, where it has one.
    file: Option<PathBuf>,
    bytes: u64,
    figures: Option<Figures>,
}

pub(crate) fn run(args: &Mesh) -> anyhow::Result<Outcome> {
    let replace = Replace::from(&args.overwrite);
    let job = Job::new(&args.run);
    let apart = is_apart(&args.out)?;
    if !args.dry_run {
        let folder_only = if apart { Replace::Yes } else { replace };
        output::check_target(&args.out, folder_only)?;
        if !apart {
            // Says at once what the format cannot do; dropping it leaves nothing.
            drop(formats::create_labelled_mesh_sink(
                &args.out,
                replace == Replace::Yes,
            )?);
        }
        if let Some(shot) = &args.shot.picture {
            picture::check_png_name(shot)?;
            output::check_target(shot, replace)?;
        }
    }
    let volume = pick::open(&args.volume, &args.pick, &job.budget)?;
    let blame = named(&[&args.volume, &args.out]);
    let source = volume.labels().map_err(&blame)?;
    let options = options(args, &volume).map_err(&blame)?;
    if args.dry_run {
        let blocks = label_blocks(&source, &options).map_err(&blame)?;
        let memory = job.budget.memory_bytes();
        let text = format!(
            "{}: would read up to {} blocks of {}^3 samples once, in at most {} of memory\n",
            args.volume.display(),
            thousands(blocks),
            source.block_edge(),
            human_bytes(memory)
        );
        let json = json!({
            "schema": 1, "command": "mesh", "dry_run": true, "volume": args.volume,
            "blocks": blocks, "block_edge": source.block_edge(), "peak_memory_bytes": memory,
        });
        job.result(&text, &json)?;
        return Ok(Outcome::Done);
    }
    let scratch = formats::scratch_file(&args.out)?;
    let mut spool = LabelSpool::new(scratch, formats::mesh_capacity(&args.out)?);
    let stats = {
        let _watch = job.watch_counted("meshing", || label_blocks(&source, &options))?;
        extract_labels(&source, &options, &job.budget, &mut spool).map_err(&blame)?
    };
    spool.flush().map_err(&blame)?;
    let extracted = job.seconds();
    let made = Made {
        args,
        job: &job,
        spool: &spool,
        stats: &stats,
        replace,
    };
    let written = match apart {
        true => made.apart(),
        false => made.together(),
    }
    .map_err(&blame)?;
    let picture_bytes = made.picture(&source).map_err(&blame)?;
    report(args, &job, &stats, &written, extracted, picture_bytes)?;
    Ok(pick::outcome(&volume, &args.volume, &job))
}

/// Whether every segment gets a file of its own.
fn is_apart(out: &Path) -> Result<bool> {
    let folder = out.parent().unwrap_or(Path::new(""));
    if folder.to_string_lossy().contains(PLACE) {
        return Err(Error::bad_input(format!(
            "{}: {PLACE} stands in the name of a folder: put it into the name of the file",
            out.display()
        )));
    }
    let name = out.file_name().unwrap_or_default();
    Ok(name.to_string_lossy().contains(PLACE))
}

/// The file of a segment.
fn file_of(out: &Path, label: u32) -> PathBuf {
    let name = out.file_name().unwrap_or_default().to_string_lossy();
    out.with_file_name(name.replace(PLACE, &label.to_string()))
}

fn options(args: &Mesh, field: &dyn brickmarch::Field) -> Result<ExtractLabels> {
    if args.shot.picture.is_some() && args.space == Space::Index {
        return Err(Error::new(
            ErrorKind::Unsupported,
            "--picture is drawn in world space: leave --space index out, or draw it in a second run",
        ));
    }
    Ok(ExtractLabels {
        labels: match &args.labels {
            Some(LabelList::These(list)) => Some(list.clone()),
            _ => None,
        },
        smooth: args.label_smooth,
        relax: args.smooth.relax(),
        region: cells(args, field)?,
        boundary: match args.boundary {
            BoundaryMode::Cap => Boundary::Cap,
            BoundaryMode::Cut => Boundary::Cut,
            BoundaryMode::Tile => Boundary::Tile,
        },
        normals: args.normals || args.shot.picture.is_some(),
        keys: args.keys,
        index_space: args.space == Space::Index,
        allow_empty: args.allow_empty,
    })
}

/// Everything extracted, on its way into files.
struct Made<'a> {
    args: &'a Mesh,
    job: &'a Job,
    spool: &'a LabelSpool,
    stats: &'a LabelStats,
    replace: Replace,
}

impl Made<'_> {
    fn wanted(&self) -> Layout {
        Layout {
            normals: self.args.normals,
            keys: self.args.keys,
        }
    }

    /// Sends a segment, or those components of it that are wanted, from `begin` to `finish`.
    fn send(&self, label: u32, totals: Totals, sink: &mut dyn MeshSink) -> Result<Totals> {
        let Some(which) = keep(self.args) else {
            sink.begin(self.spool.layout())?;
            self.spool.replay(label, sink)?;
            sink.finish(totals)?;
            return Ok(totals);
        };
        let scratch = scratch_files(&self.args.out)?;
        let mut some = Components::new(which, true, scratch, &self.job.budget, sink)?;
        some.begin(self.spool.layout())?;
        self.spool.replay(label, &some)?;
        some.finish(totals)?;
        Ok(some.kept().totals)
    }

    /// Writes a segment into `file`, and measures it if wanted.
    fn pour(&self, label: u32, totals: Totals, file: &mut dyn MeshSink) -> Result<Written> {
        let mut tally = Tally::default();
        let mut tee = Tee::default();
        tee.add(file, self.wanted());
        if self.args.measure {
            tee.add(&mut tally, Layout::default());
        }
        let totals = self.send(label, totals, &mut tee)?;
        drop(tee);
        Ok(Written {
            label,
            totals,
            file: None,
            bytes: 0,
            figures: self.args.measure.then(|| tally.figures()),
        })
    }

    /// A file for each segment.
    fn apart(&self) -> Result<Vec<Written>> {
        let labels = &self.stats.labels;
        for &(label, _) in labels {
            output::check_target(&file_of(&self.args.out, label), self.replace)?;
        }
        let next = AtomicUsize::new(0);
        let written = Mutex::new(Vec::new());
        let work = || -> Result<()> {
            while let Some(&(label, totals)) = labels.get(next.fetch_add(1, Ordering::Relaxed)) {
                self.job.budget.check_cancelled()?;
                let path = file_of(&self.args.out, label);
                let mut file = formats::create_mesh_sink(&path, self.replace == Replace::Yes)?;
                let mut made = self.pour(label, totals, file.as_mut())?;
                made.bytes = std::fs::metadata(&path).map_or(0, |m| m.len());
                made.file = Some(path);
                written.lock().expect("no thread panicked").push(made);
            }
            Ok(())
        };
        // A writer has a piece and buffers of some 4 MiB.
        let fitting = (self.job.budget.free_bytes() >> 23).max(1) as usize;
        let threads = self.job.budget.threads().min(fitting);
        std::thread::scope(|scope| {
            let others: Vec<_> = (1..threads).map(|_| scope.spawn(work)).collect();
            let mut result = work();
            for other in others {
                result = result.and(other.join().expect("no thread panicked"));
            }
            result
        })?;
        let mut written = written.into_inner().expect("no thread panicked");
        written.sort_by_key(|w| w.label);
        Ok(written)
    }

    /// One file, whose faces have a label.
    fn together(&self) -> Result<Vec<Written>> {
        let out = &self.args.out;
        let mut file = formats::create_labelled_mesh_sink(out, self.replace == Replace::Yes)?;
        file.begin(self.wanted())?;
        let mut first = Totals::default();
        let mut written = Vec::new();
        for &(label, totals) in &self.stats.labels {
            self.job.budget.check_cancelled()?;
            let mut behind = Behind {
                file: file.as_ref(),
                first,
                label,
            };
            let made = self.pour(label, totals, &mut behind)?;
            first.vertices += made.totals.vertices;
            first.triangles += made.totals.triangles;
            written.push(made);
        }
        file.finish(first)?;
        Ok(written)
    }

    /// All segments in their colours; the size of the picture's file.
    fn picture(&self, source: &dyn Labels) -> Result<Option<u64>> {
        let Some(path) = &self.args.shot.picture else {
            return Ok(None);
        };
        let mut bounds = Bounds::default();
        for &(label, totals) in &self.stats.labels {
            self.send(label, totals, &mut bounds)?;
        }
        let mut raster = Raster::new(
            &look(&self.args.shot.camera, self.args.shot.picture_size),
            &bounds.world(),
            &self.job.budget,
        )?;
        for &(label, totals) in &self.stats.labels {
            self.job.budget.check_cancelled()?;
            self.send(label, totals, &mut raster)?;
        }
        let drawn: Vec<u32> = self.stats.labels.iter().map(|&(label, _)| label).collect();
        let back = source.grid().index_to_world.inverse()?;
        let shot = &self.args.shot;
        let reach = i32::from(self.args.label_smooth);
        let colours = |points: &[[f32; 3]]| -> Vec<[u8; 3]> {
            let at = |p: &[f32; 3]| nearest(source, &drawn, back.apply(p.map(f64::from)), reach);
            points
                .iter()
                .map(|p| at(p).map_or(shot.camera.colour, colourmap::label))
                .collect()
        };
        let picture = raster.painted(Some(&colours), &self.job.budget)?;
        picture.write_png(path, self.replace).map(Some)
    }
}

/// The drawn segment of the sample nearest to a point, of those at most `reach` cells away: a surface
/// that was smoothed has moved away from its samples.
fn nearest(source: &dyn Labels, drawn: &[u32], at: [f64; 3], reach: i32) -> Option<u32> {
    let domain = source.grid().domain;
    let low = at.map(|v| v.floor() as i32);
    let cell = Box3::new(low, low.map(|v| v.saturating_add(2)));
    let mut labels = Vec::new();
    (0..=reach).find_map(|more| {
        let around = cell.grow(more, more).intersect(&domain);
        labels.resize(around.count() as usize, 0);
        // A place that cannot be read keeps the plain colour.
        source.read(around, &mut labels).ok()?;
        let [nx, ny, _] = around.size().map(|n| n as usize);
        let far = |n: &usize| -> f64 {
            let local = [n % nx, n / nx % ny, n / nx / ny];
            (0..3)
                .map(|a| (f64::from(around.min[a]) + local[a] as f64 - at[a]).powi(2))
                .sum()
        };
        (0..labels.len())
            .filter(|&n| drawn.binary_search(&labels[n]).is_ok())
            .min_by(|a, b| far(a).total_cmp(&far(b)))
            .map(|n| labels[n])
    })
}

/// The mesh of a segment behind those of others in one file.
struct Behind<'a> {
    file: &'a dyn MeshSink,
    first: Totals,
    label: u32,
}

impl MeshSink for Behind<'_> {
    fn begin(&mut self, _layout: Layout) -> Result<()> {
        Ok(())
    }

    fn write(&self, piece: &Piece) -> Result<()> {
        let mut piece = piece.clone();
        piece.first_vertex += self.first.vertices;
        piece.first_triangle += self.first.triangles;
        piece
            .ids
            .iter_mut()
            .for_each(|id| *id += self.first.vertices);
        piece.label = Some(self.label);
        self.file.write(&piece)
    }

    fn finish(&mut self, _totals: Totals) -> Result<()> {
        Ok(())
    }
}

/// Where the vertices lie.
struct Bounds(Mutex<[Vec3; 2]>);

impl Default for Bounds {
    fn default() -> Self {
        Self(Mutex::new([Vec3::INFINITY, Vec3::NEG_INFINITY]))
    }
}

impl Bounds {
    fn world(&self) -> WorldBox {
        let [low, high] = *self.0.lock().expect("no thread panicked");
        let corner = |c: usize| {
            DVec3::from_array(std::array::from_fn(|a| {
                f64::from(if c >> a & 1 == 0 { low[a] } else { high[a] })
            }))
        };
        let corners = match low.cmple(high).all() {
            true => (0..8).map(corner).collect(),
            // Nothing to see.
            false => vec![DVec3::ZERO, DVec3::ONE],
        };
        WorldBox { corners }
    }
}

impl MeshSink for Bounds {
    fn begin(&mut self, _layout: Layout) -> Result<()> {
        Ok(())
    }

    fn write(&self, piece: &Piece) -> Result<()> {
        let mut bounds = self.0.lock().expect("no thread panicked");
        for &p in &piece.positions {
            bounds[0] = bounds[0].min(Vec3::from(p));
            bounds[1] = bounds[1].max(Vec3::from(p));
        }
        Ok(())
    }

    fn finish(&mut self, _totals: Totals) -> Result<()> {
        Ok(())
    }
}

fn report(
    args: &Mesh,
    job: &Job,
    stats: &LabelStats,
    written: &[Written],
    extracted: f64,
    picture_bytes: Option<u64>,
) -> std::io::Result<()> {
    let took = job.seconds();
    let sum = |of: fn(&Totals) -> u64| -> u64 { written.iter().map(|w| of(&w.totals)).sum() };
    let (vertices, triangles) = (sum(|t| t.vertices), sum(|t| t.triangles));
    let apart: u64 = written.iter().map(|w| w.bytes).sum();
    let bytes_out = match std::fs::metadata(&args.out) {
        Ok(whole) if apart == 0 => whole.len(),
        _ => apart,
    };
    let open = written
        .iter()
        .filter(|w| w.figures.is_some_and(|f| !f.closed))
        .count();
    let text = format!(
        "{}: {} labels, {} triangles, {} vertices{}, {}, {}, peak {}\n",
        args.out.display(),
        thousands(written.len() as u64),
        thousands(triangles),
        thousands(vertices),
        match (args.measure, open) {
            (false, _) => String::new(),
            (true, 0) => ", all closed".to_string(),
            (true, n) => format!(", {n} open"),
        },
        human_bytes(bytes_out),
        seconds(took),
        Job::peak_text(),
    );
    let each: Vec<Value> = written.iter().map(entry).collect();
    let json = json!({
        "schema": 1, "command": "mesh", "volume": args.volume, "out": args.out,
        "labels": each, "label_smooth": args.label_smooth,
        "vertices": vertices, "triangles": triangles, "active_cells": stats.active_cells,
        "blocks_visited": stats.blocks_visited, "blocks_decoded": stats.blocks_decoded,
        "front_bytes_max": stats.front_bytes_max,
        "seconds": took, "seconds_extracting": extracted,
        "peak_rss_bytes": crate::system::peak_resident_bytes(),
        "budget_peak_bytes": job.budget.peak_bytes(), "mem_bytes": args.run.limits.mem,
        "bytes_out": bytes_out, "picture": args.shot.picture, "picture_bytes": picture_bytes,
    });
    job.result(&text, &json)
}

fn entry(written: &Written) -> Value {
    let mut json = json!({
        "label": written.label, "vertices": written.totals.vertices,
        "triangles": written.totals.triangles,
    });
    if let Some(file) = &written.file {
        json["out"] = json!(file);
        json["bytes_out"] = json!(written.bytes);
    }
    if let Some(figures) = written.figures {
        json["closed"] = json!(figures.closed);
        json["euler"] = json!(figures.euler);
        json["area"] = json!(figures.area);
        json["signed_volume"] = json!(figures.volume);
    }
    json
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_place_of_the_number_is_in_the_name_of_the_file() {
        assert!(is_apart(Path::new("a/{label}.ply")).expect("plain"));
        assert!(!is_apart(Path::new("a/b.ply")).expect("plain"));
        assert!(is_apart(Path::new("{label}/b.ply")).is_err());
        assert_eq!(
            file_of(Path::new("a/seg-{label}.stl"), 4_000_000_000),
            Path::new("a/seg-4000000000.stl")
        );
    }
}
