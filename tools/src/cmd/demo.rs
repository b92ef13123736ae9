//! `demo`: the whole pipeline on a real scan and on a field that is larger than the memory allowed.

use super::import::import_file;
use super::mesh::{Passed, add_figures, count_work, pass};
use super::slice;
use super::{named, seconds, thousands};
use crate::Outcome;
use crate::args::{Demo, MapName};
use crate::job::Job;
use crate::output::{self, Replace};
use crate::render::{Look, Raster, View, crossing_bounds};
use crate::system;
use crate::tally::Figures;
use brickmarch::budget::human_bytes;
use brickmarch::iso::{Extract, Stats};
use brickmarch::mesh::{Layout, check};
use brickmarch::store::{self, ImportOptions, Volume, VolumeSpec};
use brickmarch::{Error, ErrorKind, Field, Kind, Result};
use brickmarch_data_gen::{Scene, SceneField, SceneName};
use brickmarch_formats::{OpenOptions, create_mesh_sink, read_mesh};
use serde_json::{Value, json};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// 128^3 samples of a CT of a chest; see assets/NOTICE.md.
const SCAN: &[u8] = include_bytes!("../../assets/ct_abdomen_crop128_i16.nrrd");
const SCAN_NOTICE: &str = include_str!("../../assets/NOTICE.md");
/// Bone, in Hounsfield units.
const BONE: f32 = 200.0;
/// In less memory than this the pictures are half as wide.
const LARGE_PICTURE_BYTES: u64 = 128 << 20;
/// First line of the file by which a later run knows that the folder is its own.
const MARK: &str = "Results of `brickmarch demo`; a later run replaces them.";

pub(crate) fn run(args: &Demo) -> anyhow::Result<Outcome> {
    let job = Job::new(&args.run);
    let scene = Scene::new(SceneName::LevelSetGyroid, args.size)
        .map_err(|e| Error::bad_input(format!("--size {}: {e}", args.size)))?;
    let replace = open_folder(args)?;
    let out = Out {
        dir: &args.dir,
        replace,
        job: &job,
    };
    let need = disk_need(&scene);
    check_disk(&args.dir, need)?;
    out.say(&format!(
        "Memory {}, {} threads, results in {} (up to {} of disk while it runs).\n",
        human_bytes(args.run.limits.mem),
        job.budget.threads(),
        args.dir.display(),
        human_bytes(need),
    ))?;

    out.say(
        "\nA real CT scan, 128 x 128 x 128 samples: import, check, bone at 200 HU, pictures\n",
    )?;
    let scan = scan(&out)?;
    let n = args.size;
    out.say(&format!(
        "\nA gyroid on {n}^3 samples ({} as a plain array): store sparsely, walk, mesh, picture\n",
        human_bytes(u64::from(n).pow(3) * 4)
    ))?;
    let gyroid = gyroid(&out, scene)?;

    let took = job.seconds();
    let table = summary(
        &[("CT scan", &scan), (&format!("gyroid {n}^3"), &gyroid)],
        took,
    );
    out.say(&table)?;
    if args.run.say.json {
        let json = json!({
            "schema": 1, "command": "demo", "dir": args.dir, "mem_bytes": args.run.limits.mem,
            "threads": job.budget.threads(), "seconds": took,
            "scan": scan.json(), "gyroid": gyroid.json(),
        });
        job.result("", &json)?;
    }
    let sound = scan.sound && gyroid.sound;
    Ok(if sound {
        Outcome::Done
    } else {
        Outcome::NotWhatWasAsked
    })
}

/// Where results and words go.
struct Out<'a> {
    dir: &'a Path,
    replace: Replace,
    job: &'a Job,
}

impl Out<'_> {
    fn path(&self, name: &str) -> PathBuf {
        self.dir.join(name)
    }

    /// Text for people on standard output; nothing with `--json`.
    fn say(&self, text: &str) -> Result<()> {
        if self.job.say.json {
            return Ok(());
        }
        let mut out = std::io::stdout().lock();
        let written = out.write_all(text.as_bytes()).and_then(|()| out.flush());
        written.map_err(|e| Error::io(Path::new("standard output"), "writing", e))
    }

    /// Runs a step, and says what came of it and how long it took.
    fn step<T>(&self, name: &str, run: impl FnOnce() -> Result<(T, String)>) -> Result<(T, f64)> {
        self.counted_step(name, || Ok(0), run)
    }

    /// A step whose work is counted beforehand by `count`.
    fn counted_step<T>(
        &self,
        name: &str,
        count: impl FnOnce() -> Result<u64>,
        run: impl FnOnce() -> Result<(T, String)>,
    ) -> Result<(T, f64)> {
        let begun = Instant::now();
        let (value, text) = {
            let _watch = self.job.watch_counted(name, count)?;
            run()?
        };
        let took = begun.elapsed().as_secs_f64();
        self.say(&format!("  {name:<10} {took:>7.2} s  {text}\n"))?;
        Ok((value, took))
    }
}

/// Figures of one half of the demo.
struct Part {
    steps: Vec<(&'static str, f64)>,
    stats: Stats,
    figures: Figures,
    volume_bytes: u64,
    plain_bytes: u64,
    mesh_bytes: u64,
    peak_bytes: Option<u64>,
    sound: bool,
    truth: Value,
}

impl Part {
    fn seconds(&self) -> f64 {
        self.steps.iter().map(|(_, s)| s).sum()
    }

    fn json(&self) -> Value {
        let mut json = json!({
            "steps": self.steps.iter().map(|(n, s)| json!({ "step": n, "seconds": s })).collect::<Vec<_>>(),
            "seconds": self.seconds(), "volume_bytes": self.volume_bytes,
            "plain_bytes": self.plain_bytes, "mesh_bytes": self.mesh_bytes,
            "peak_rss_bytes": self.peak_bytes, "sound": self.sound, "truth": self.truth,
        });
        add_figures(&mut json, &self.stats, Some(&self.figures));
        json
    }
}

fn scan(out: &Out<'_>) -> Result<Part> {
    system::reset_peak_resident();
    let budget = &out.job.budget;
    let (source, volume_path) = (out.path("ct_abdomen_crop128_i16.nrrd"), out.path("ct.bvol"));
    let (mesh_path, picture) = (out.path("ct_bone.ply"), out.path("ct_bone.png"));
    output::write_whole(&source, out.replace, |file| file.write_all(SCAN))?;

    let (info, import) = out.step("import", || {
        let keep = |_: &mut VolumeSpec| {};
        let made = import_file(
            &source,
            &OpenOptions::default(),
            &volume_path,
            out.replace,
            &keep,
            &ImportOptions::default(),
            budget,
        )?;
        let info = made.info;
        let text = format!(
            "{} -> {}, {} to {} HU",
            human_bytes(info.bytes_raw),
            human_bytes(info.bytes_file),
            info.range.min,
            info.range.max
        );
        Ok((info, text))
    })?;
    let (intact, verify) = out.step("verify", || {
        let intact = store::verify(&volume_path, budget)?.is_intact();
        let text = if intact {
            "every checksum and rule holds"
        } else {
            "DAMAGED"
        };
        Ok((intact, text.to_string()))
    })?;
    let volume = Volume::open(&volume_path, budget)?;
    let ((), slice) = out.step("slice", || {
        let path = out.path("ct_slice.png");
        let options = slice::Options {
            axis: 2,
            index: 64,
            window: Some((-400.0, 600.0)),
            map: MapName::Grey,
            scale: 4.0,
        };
        let drawn = slice::draw(&volume, volume.grid().domain, &options, budget)?;
        drawn.picture.write_png(&path, out.replace)?;
        Ok(((), file_text(&path)))
    })?;
    let options = Extract {
        iso: BONE,
        normals: true,
        ..Extract::default()
    };
    let look = Look {
        view: View {
            azimuth_deg: 25.0,
            elevation_deg: 15.0,
        },
        ..Look::default()
    };
    let wanted = Layout {
        normals: true,
        keys: false,
    };
    let drawn = draw_mesh(out, &volume, &options, &mesh_path, wanted, &look)?;
    let shade = drawn.shade(out, &picture)?;
    let (report, check) = out.step("check", || {
        let mesh = read_mesh(&mesh_path, budget)?;
        let report = check(&mesh, budget)?;
        let text = format!(
            "{}, {} components, genus {}, {:.1} ml",
            if super::check::is_sound(&report, false) {
                "closed 2-manifold, oriented"
            } else {
                "NOT SOUND"
            },
            thousands(report.components),
            report.genus.map_or("?".to_string(), thousands),
            report.volume / 1000.0
        );
        Ok((report, text))
    })?;
    let truth = super::check::figures(&report);
    Ok(Part {
        steps: vec![
            ("import", import),
            ("verify", verify),
            ("slice", slice),
            ("mesh", drawn.seconds),
            ("shade", shade),
            ("check", check),
        ],
        stats: drawn.stats,
        figures: drawn.figures,
        volume_bytes: info.bytes_file,
        plain_bytes: info.bytes_raw,
        mesh_bytes: file_bytes(&mesh_path),
        peak_bytes: system::peak_resident_bytes(),
        sound: intact && drawn.figures.closed && super::check::is_sound(&report, false),
        truth,
    })
}

fn gyroid(out: &Out<'_>, scene: Scene) -> Result<Part> {
    system::reset_peak_resident();
    let budget = &out.job.budget;
    let n = scene.n();
    let (volume_path, mesh_path, picture) = (
        out.path(&format!("gyroid_{n}.bvol")),
        out.path(&format!("gyroid_{n}.ply")),
        out.path(&format!("gyroid_{n}.png")),
    );
    output::check_target(&volume_path, out.replace)?;
    let (iso, exact) = (scene.iso(), scene.exact());
    let (info, write) = out.step("store", || {
        let field = SceneField::new(scene.clone());
        let mut spec = VolumeSpec::new(*field.grid(), field.sample_type());
        spec.kind = field.kind();
        spec.background = f64::from(scene.background());
        spec.name = format!("gyroid {n}");
        spec.history = "level set of a gyroid, 8 periods per edge".to_string();
        let info = store::write_field(&field, &spec, &volume_path, budget)
            .map_err(named(&[&volume_path]))?;
        let text = format!(
            "{} -> {}: {} bricks of {}^3 stored, {} in constant tiles",
            human_bytes(info.bytes_raw),
            human_bytes(info.bytes_file),
            thousands(info.bricks_stored),
            info.brick_edge,
            thousands(info.bricks_constant + info.bricks_background),
        );
        Ok((info, text))
    })?;
    let volume = Volume::open(&volume_path, budget)?;
    debug_assert_eq!(volume.kind(), Kind::Distance);
    let options = Extract {
        iso,
        normals: true,
        ..Extract::default()
    };
    let look = Look {
        colour: [214, 156, 120],
        ..Look::default()
    };
    let drawn = draw_mesh(out, &volume, &options, &mesh_path, Layout::default(), &look)?;
    let shade = drawn.shade(out, &picture)?;
    let (mut sound, mut truth) = (drawn.figures.closed, Value::Null);
    if let Some(exact) = exact {
        let area = exact.area + exact.cap_area;
        let error = |found: f64, exact: f64| (found / exact - 1.0) * 100.0;
        let (area_error, volume_error) = (
            error(drawn.figures.area, area),
            error(drawn.figures.volume, exact.volume),
        );
        let mut text =
            format!("area {area_error:+.4} %, volume {volume_error:+.4} % off the formula");
        if let (Some(exact), Some(found)) = (exact.euler, drawn.figures.euler) {
            text += &format!(", Euler number {found} (exact {exact})");
            sound &= found == exact;
        }
        out.say(&format!("  {:<10} {:>9}  {text}\n", "truth", ""))?;
        truth = json!({
            "area": area, "volume": exact.volume, "euler": exact.euler,
            "area_error_percent": area_error, "volume_error_percent": volume_error,
        });
    }
    Ok(Part {
        steps: vec![("store", write), ("mesh", drawn.seconds), ("shade", shade)],
        stats: drawn.stats,
        figures: drawn.figures,
        volume_bytes: info.bytes_file,
        plain_bytes: info.bytes_raw,
        mesh_bytes: file_bytes(&mesh_path),
        peak_bytes: system::peak_resident_bytes(),
        sound,
        truth,
    })
}

/// A mesh that was written and drawn at the same time.
struct Drawn {
    raster: Raster,
    stats: Stats,
    figures: Figures,
    seconds: f64,
}

/// One pass: extraction into a file, a tally and a picture.
fn draw_mesh(
    out: &Out<'_>,
    volume: &Volume,
    options: &Extract,
    path: &Path,
    wanted: Layout,
    look: &Look,
) -> Result<Drawn> {
    let budget = &out.job.budget;
    let mut look = look.clone();
    if budget.memory_bytes() < LARGE_PICTURE_BYTES {
        (look.width, look.height) = (600, 450);
    }
    let mut file = create_mesh_sink(path, out.replace == Replace::Yes)?;
    let bounds = crossing_bounds(
        volume,
        volume.grid().domain,
        options.iso,
        volume.kind().inside(),
    )?;
    let mut raster = Raster::new(&look, &bounds, budget)?;
    let count = || count_work(volume, options, budget);
    let ((stats, figures), seconds) = out.counted_step("mesh", count, || {
        let Passed { stats, figures, .. } = pass(
            volume,
            options,
            budget,
            file.as_mut(),
            wanted,
            Some(&mut raster),
            true,
        )
        .map_err(named(&[path]))?;
        let figures = figures.expect("asked to measure");
        let text = format!(
            "{} triangles, {} vertices, {}, {}",
            thousands(stats.triangles),
            thousands(stats.vertices),
            if figures.closed {
                "closed and oriented"
            } else {
                "OPEN"
            },
            file_text(path),
        );
        Ok(((stats, figures), text))
    })?;
    Ok(Drawn {
        raster,
        stats,
        figures,
        seconds,
    })
}

impl Drawn {
    /// Shades and writes the picture; gives the seconds.
    fn shade(&self, out: &Out<'_>, path: &Path) -> Result<f64> {
        let ((), took) = out.step("shade", || {
            let picture = self.raster.picture(&out.job.budget)?;
            picture.write_png(path, out.replace)?;
            Ok(((), file_text(path)))
        })?;
        Ok(took)
    }
}

/// Makes the folder and leaves the mark. Files of an earlier run may be replaced, others only when
/// that was asked.
fn open_folder(args: &Demo) -> Result<Replace> {
    let dir = &args.dir;
    std::fs::create_dir_all(dir).map_err(|e| Error::io(dir, "making the folder", e))?;
    let readme = dir.join("README.txt");
    let ours = std::fs::read_to_string(&readme).is_ok_and(|text| text.starts_with(MARK));
    let replace = if ours {
        Replace::Yes
    } else {
        Replace::from(&args.overwrite)
    };
    let n = args.size;
    let text = format!(
        "{MARK}\n\n\
         ct_abdomen_crop128_i16.nrrd  the scan as it came\n\
         ct.bvol                      the scan as a volume\n\
         ct_slice.png                 a slice of it\n\
         ct_bone.ply, ct_bone.png     the surface at 200 HU\n\
         gyroid_{n}.bvol             a gyroid, stored sparsely\n\
         gyroid_{n}.ply, .png        its surface\n\n\
         {SCAN_NOTICE}"
    );
    output::write_whole(&readme, replace, |file| file.write_all(text.as_bytes()))?;
    Ok(replace)
}

/// Bytes that the results and scratch files of the large part may take at one time.
fn disk_need(scene: &Scene) -> u64 {
    let area = scene
        .exact()
        .map_or(6.0 * f64::from(scene.n()).powi(2), |e| e.area + e.cap_area);
    // Measured: 3.05 triangles for each unit of area, half as many vertices. 13 bytes a triangle
    // (twice while they wait in a scratch file) and 12 a vertex; the volume is smaller.
    let triangles = 3.05 * area;
    let mesh = triangles * (2.0 * 13.0 + 6.0);
    let volume = area * 30.0;
    (mesh + volume) as u64 + (32 << 20)
}

fn check_disk(dir: &Path, need: u64) -> Result<()> {
    match system::free_disk_bytes(dir) {
        Some(free) if free < need => Err(Error::new(
            ErrorKind::Io,
            format!(
                "{}: the demo needs about {} of disk and {} are free: name another folder, or a smaller field with --size",
                dir.display(),
                human_bytes(need),
                human_bytes(free)
            ),
        )),
        _ => Ok(()),
    }
}

fn summary(parts: &[(&str, &Part)], took: f64) -> String {
    let mut text = format!(
        "\n  {:<14} {:>10} {:>13} {:>12} {:>12} {:>12} {:>14}\n",
        "", "wall time", "triangles", "plain array", "volume file", "mesh file", "peak resident"
    );
    for (name, part) in parts {
        let peak = part.peak_bytes.map_or("unknown".to_string(), human_bytes);
        text += &format!(
            "  {name:<14} {:>10} {:>13} {:>12} {:>12} {:>12} {peak:>14}\n",
            seconds(part.seconds()),
            thousands(part.stats.triangles),
            human_bytes(part.plain_bytes),
            human_bytes(part.volume_bytes),
            human_bytes(part.mesh_bytes),
        );
    }
    text + &format!("  {:<14} {:>10}\n", "all", seconds(took))
}

fn file_bytes(path: &Path) -> u64 {
    std::fs::metadata(path).map_or(0, |m| m.len())
}

fn file_text(path: &Path) -> String {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    format!("{name} ({})", human_bytes(file_bytes(path)))
}
