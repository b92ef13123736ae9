//! Writes scenes to disk at any size inside a memory budget, and prints their known answers.
#![expect(
    clippy::print_stdout,
    reason = "a command line tool prints its results"
)]

mod answers;
mod write;

use anyhow::{Context, Result, bail};
use brickmarch::store::{Volume, VolumeSpec};
use brickmarch::{Box3, Budget, Field, Grid};
use brickmarch_data_gen::{Sample, Scene, SceneName, Texture, TextureField};
use clap::{Args, Parser, Subcommand, ValueEnum};
use std::path::PathBuf;
use std::process::ExitCode;

/// Analytic fields, phantoms and level sets with known answers.
#[derive(Parser)]
#[command(name = "brickmarch-data-gen", version)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Writes the samples of a scene: OUT.raw (little-endian, x fastest) or OUT.bvol.
    Field {
        /// sphere, gyroid, torus, two-spheres, noise, ct, level-set-sphere or level-set-gyroid
        scene: SceneName,
        #[command(flatten)]
        size: SizeArgs,
        #[command(flatten)]
        output: OutputArgs,
    },
    /// Writes a scene as a narrow band: distances to 3 voxels, 3 outside and -3 inside of it.
    LevelSet {
        /// The surface.
        scene: BandScene,
        #[command(flatten)]
        size: SizeArgs,
        #[command(flatten)]
        output: OutputArgs,
    },
    /// Writes a solid texture: the volumes color.r, color.g and color.b of OUT.bvol.
    Texture {
        /// wood or marble
        texture: Texture,
        #[command(flatten)]
        space: TextureSpace,
        #[command(flatten)]
        output: TextureOutput,
    },
    /// Prints area, volume and topology of a scene, from formulas and counted on its lattice.
    Exact {
        /// As for `field`.
        scene: SceneName,
        #[command(flatten)]
        size: SizeArgs,
        /// Isovalue instead of the scene's own; formulas know only that one.
        #[arg(long, allow_negative_numbers = true)]
        iso: Option<f32>,
        /// Print one JSON object.
        #[arg(long)]
        json: bool,
        /// Formulas only: do not count on the lattice, which reads every sample once.
        #[arg(long)]
        no_lattice: bool,
    },
}

#[derive(Clone, Copy, ValueEnum)]
enum BandScene {
    Gyroid,
    Sphere,
}

/// Where a texture is.
#[derive(Args)]
struct TextureSpace {
    /// Points per side of a cube; world is index space.
    #[arg(long, required_unless_present = "like", conflicts_with = "like")]
    n: Option<u32>,
    /// The points of this volume file, and their place in the world.
    #[arg(long)]
    like: Option<PathBuf>,
    /// Distance of rings or veins in world units [default: a sixteenth of the longest side].
    #[arg(long)]
    period: Option<f64>,
    /// World position of the middle of the rings, as X,Y,Z [default: beside the middle].
    #[arg(long, value_parser = parse_point, allow_hyphen_values = true)]
    centre: Option<[f64; 3]>,
}

#[derive(Args)]
struct TextureOutput {
    /// The .bvol file to write.
    #[arg(long, short)]
    out: PathBuf,
    /// Memory for data, such as 64MiB.
    #[arg(long, default_value = "256MiB", value_parser = parse_bytes)]
    mem: u64,
    /// Threads; as many as there are cores by default.
    #[arg(long)]
    threads: Option<usize>,
    /// Replace an existing file.
    #[arg(long)]
    overwrite: bool,
}

#[derive(Args)]
struct SizeArgs {
    /// Points per side of a cube.
    #[arg(long, required_unless_present = "size", conflicts_with = "size")]
    n: Option<u32>,
    /// Points per axis, as X,Y,Z.
    #[arg(long, value_parser = parse_size)]
    size: Option<[u32; 3]>,
}

#[derive(Args)]
pub(crate) struct OutputArgs {
    /// Where to: the extension says what is written, .raw or .bvol.
    #[arg(long, short)]
    out: PathBuf,
    /// Type of the samples; the scene's own by default.
    #[arg(long = "type")]
    sample: Option<SampleArg>,
    /// With --type i16: samples are round(value * scale). 16 for distances, 1000 for others.
    #[arg(long, allow_negative_numbers = true)]
    scale: Option<f32>,
    /// For .bvol: edge of the bricks, 8, 16, 32 or 64.
    #[arg(long)]
    brick: Option<u32>,
    /// Memory for data, such as 64MiB.
    #[arg(long, default_value = "256MiB", value_parser = parse_bytes)]
    mem: u64,
    /// Threads; as many as there are cores by default.
    #[arg(long)]
    threads: Option<usize>,
    /// Replace an existing file.
    #[arg(long)]
    overwrite: bool,
}

#[derive(Clone, Copy, PartialEq, ValueEnum)]
enum SampleArg {
    F32,
    I16,
}

fn main() -> ExitCode {
    let cli = Cli::parse();
    match run(cli.command) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            report(&error);
            ExitCode::FAILURE
        }
    }
}

#[expect(clippy::print_stderr, reason = "errors go to standard error")]
fn report(error: &anyhow::Error) {
    eprintln!("error: {error:#}");
}

fn run(command: Command) -> Result<()> {
    match command {
        Command::Field {
            scene,
            size,
            output,
        } => write_scene(scene, &size, &output),
        Command::LevelSet {
            scene,
            size,
            output,
        } => {
            let name = match scene {
                BandScene::Gyroid => SceneName::LevelSetGyroid,
                BandScene::Sphere => SceneName::LevelSetSphere,
            };
            write_scene(name, &size, &output)
        }
        Command::Texture {
            texture,
            space,
            output,
        } => write_texture(texture, &space, &output),
        Command::Exact {
            scene,
            size,
            iso,
            json,
            no_lattice,
        } => {
            let scene = Scene::with_size(scene, size.get()?)?;
            print!("{}", answers::text(&scene, iso, json, !no_lattice)?);
            Ok(())
        }
    }
}

fn write_scene(name: SceneName, size: &SizeArgs, output: &OutputArgs) -> Result<()> {
    let mut budget = Budget::bytes(output.mem);
    if let Some(threads) = output.threads {
        budget = budget.with_threads(threads);
    }
    let size = size.get()?;
    // The tables of a scene, see `Scene`.
    let longest = u64::from(size[0].max(size[1]).max(size[2]));
    let _tables = budget.take(128 * longest, "the tables of the scene")?;
    let scene = Scene::with_size(name, size)?;
    let (scene, sample) = stored_as(scene, output)?;
    let bytes = write::write(scene, sample, output, &budget)?;
    let [x, y, z] = size;
    let kind = match sample {
        Sample::F32 => "f32",
        Sample::I16 => "i16",
    };
    println!(
        "{}: {name} {x} x {y} x {z} {kind}, {bytes} bytes",
        output.out.display()
    );
    Ok(())
}

fn write_texture(texture: Texture, space: &TextureSpace, output: &TextureOutput) -> Result<()> {
    let mut budget = Budget::bytes(output.mem);
    if let Some(threads) = output.threads {
        budget = budget.with_threads(threads);
    }
    let grid = match (&space.like, space.n) {
        (Some(path), _) => *Volume::open(path, &budget)?.grid(),
        (None, Some(n)) => {
            let n = i32::try_from(n).ok().filter(|&n| n > 0);
            let n = n.context("--n is from 1 to 2147483647")?;
            Grid::new(Box3::from_size([n; 3]))
        }
        (None, None) => bail!("give --n or --like"),
    };
    let [low, high] = TextureField::bounds(&grid);
    let sides: [f64; 3] = std::array::from_fn(|a| high[a] - low[a]);
    let longest = sides.into_iter().fold(0.0, f64::max);
    let spacing = grid
        .index_to_world
        .spacing()
        .into_iter()
        .fold(0.0, f64::max);
    let period = space.period.unwrap_or(longest.max(spacing) / 16.0);
    if !(period.is_finite() && period > 0.0) {
        bail!("--period {period}: give a distance above 0, in world units");
    }
    // Beside the middle, where rings are bent less than at their centre.
    let beside = || std::array::from_fn(|a| low[a] + sides[a] * [0.3, 0.2, 0.5][a]);
    let centre = space.centre.unwrap_or_else(beside);
    let out = &output.out;
    if out.extension().is_none_or(|e| e != "bvol") {
        bail!(
            "{}: textures are written as volumes: use .bvol",
            out.display()
        );
    }
    if out.exists() && !output.overwrite {
        bail!("{} exists: give --overwrite to replace it", out.display());
    }
    let channels = TextureField::channels(texture, grid, centre, period);
    let specs = channels.each_ref().map(TextureField::volume_spec);
    let all: Vec<(&dyn Field, &VolumeSpec)> = (channels.iter().zip(&specs))
        .map(|(field, spec)| (field as &dyn Field, spec))
        .collect();
    brickmarch::store::write_fields(&all, out, &budget)?;
    let bytes = std::fs::metadata(out)
        .with_context(|| out.display().to_string())?
        .len();
    let [x, y, z] = grid.domain.size();
    println!(
        "{}: {texture} {x} x {y} x {z}, {bytes} bytes",
        out.display()
    );
    Ok(())
}

/// The scene and the type of its samples as asked for.
fn stored_as(scene: Scene, output: &OutputArgs) -> Result<(Scene, Sample)> {
    let own = scene.sample();
    let asked = match output.sample {
        None if output.scale.is_some() => Sample::I16,
        None => own,
        Some(SampleArg::F32) => Sample::F32,
        Some(SampleArg::I16) => Sample::I16,
    };
    if let Some(scale) = output.scale {
        if asked == Sample::F32 {
            bail!("--scale {scale} goes with --type i16; f32 samples are not scaled");
        }
        if !scale.is_finite() || scale == 0.0 {
            bail!("--scale {scale} leaves nothing of the samples: give a number that is not zero");
        }
    }
    let default_scale = match scene.meaning() {
        brickmarch_data_gen::Meaning::Distance => 16.0,
        brickmarch_data_gen::Meaning::Density => 1000.0,
    };
    let scene = match (own, asked, output.scale) {
        (_, Sample::I16, Some(scale)) => scene.quantized(scale),
        (Sample::F32, Sample::I16, None) => scene.quantized(default_scale),
        _ => scene,
    };
    Ok((scene, asked))
}

impl SizeArgs {
    fn get(&self) -> Result<[u32; 3]> {
        self.size
            .or(self.n.map(|n| [n; 3]))
            .context("give --n or --size")
    }
}

fn parse_size(text: &str) -> Result<[u32; 3], String> {
    let sides: Vec<u32> = text
        .split(',')
        .map(|part| part.trim().parse())
        .collect::<Result<_, _>>()
        .map_err(|e| format!("{e}: write X,Y,Z"))?;
    sides
        .try_into()
        .map_err(|_| "write three sides as X,Y,Z".to_owned())
}

fn parse_point(text: &str) -> Result<[f64; 3], String> {
    let bad = || format!("'{text}': write three finite numbers as X,Y,Z");
    let all: Vec<f64> = text
        .split(',')
        .map(|part| part.trim().parse().map_err(|_| bad()))
        .collect::<Result<_, _>>()?;
    let point: [f64; 3] = all.try_into().map_err(|_| bad())?;
    let finite = point.iter().all(|v| v.is_finite());
    finite.then_some(point).ok_or_else(bad)
}

fn parse_bytes(text: &str) -> Result<u64, String> {
    let digits = text
        .find(|c: char| !c.is_ascii_digit())
        .unwrap_or(text.len());
    let (number, unit) = text.split_at(digits);
    let shift = match unit.trim() {
        "" | "B" => 0,
        "KiB" | "K" => 10,
        "MiB" | "M" => 20,
        "GiB" | "G" => 30,
        "TiB" | "T" => 40,
        _ => return Err(format!("'{unit}' is not a unit: use KiB, MiB or GiB")),
    };
    let number: u64 = number
        .parse()
        .map_err(|_| format!("'{text}' is not a size: write such as 256MiB"))?;
    number
        .checked_mul(1 << shift)
        .ok_or_else(|| format!("{text} is more than any machine has"))
}
