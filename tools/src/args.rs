//! The command line: one definition per flag; help, completions and manual pages come from here.

use crate::parse;
use brickmarch::query::Method;
use brickmarch::{Box3, Kind, SampleType};
use clap::{Args, Parser, Subcommand, ValueEnum};
use std::path::PathBuf;

const EXIT_CODES: &str = "\
Exit codes: 0 done; 1 failed or bad input; 2 wrong usage; 3 finished, but the result is not what was
asked (check: the mesh is open or not a 2-manifold; verify: the file is damaged); 130 and 143 stopped
by SIGINT and SIGTERM (serve ends so with 0, when the requests that ran are answered).

Results go to standard output, progress and messages to standard error.";

/// Sparse out-of-core volumes and exact closed isosurfaces, inside a memory budget.
#[derive(Parser, Debug)]
#[command(name = "brickmarch", version, propagate_version = true, after_help = EXIT_CODES)]
#[command(args_override_self = true)]
pub(crate) struct Cli {
    #[command(subcommand)]
    pub command: Command,
    /// End when the process with this number does, which started this one: what a batch gives its tasks
    #[arg(long, hide = true, global = true, value_name = "PID")]
    pub die_with_parent: Option<i32>,
}

#[derive(Subcommand, Debug)]
pub(crate) enum Command {
    /// Run the whole pipeline on a real CT scan and on a 1024^3 field, and leave the results
    Demo(Demo),
    /// Turn a volume of another format into a .bvol file
    Import(Import),
    /// Write a volume, or a region of it, as raw samples, .npy or .nrrd
    Export(Export),
    /// Say what is in a volume file
    Info(Info),
    /// Read every byte of a volume file and check every checksum and rule
    Verify(Verify),
    /// Copy a volume file without dead bytes and older commits, bricks in Morton order
    Compact(Compact),
    /// Extract the isosurface of a volume as a closed triangle mesh (.ply, .stl, .obj)
    Mesh(Mesh),
    /// Join the parts of a mesh (`mesh --part`) into what one run would have made, byte for byte
    Join(Join),
    /// Turn a scene of shapes, formulas and booleans into a volume or a mesh, at any resolution
    Model(Model),
    /// Check a mesh: closed, 2-manifold, oriented, components, genus, area, volume
    Check(Check),
    /// Values of a volume at the points of a CSV or NumPy file
    Sample(Sample),
    /// First crossing, largest value or integral of a volume along the rays of a CSV or NumPy file
    Ray(Ray),
    /// Picture of a volume or a scene by casting rays, without a mesh
    Render(Render),
    /// Write a slice of a volume, along an axis or in any direction, as a picture, with isolines
    Slice(Slice),
    /// Run the tasks of a job file in one memory budget; run it again to go on after a stop
    Batch(Batch),
    /// Serve volumes over HTTP: a page that shows them, slices, regions, meshes
    #[cfg(feature = "serve")]
    Serve(Serve),
    /// Print a completion script for a shell
    Completions(Completions),
    /// Write the manual pages into a folder
    Man(Man),
}

/// How much may be used.
#[derive(Args, Debug, Clone)]
#[command(next_help_heading = "Limits")]
pub(crate) struct Limits {
    /// Memory for data; peak resident memory stays below this plus 48 MiB
    #[arg(long, value_name = "SIZE", default_value = "256MiB", value_parser = parse::size)]
    pub mem: u64,
    /// Threads at most [default: one per core]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
}

/// What is said, and how.
#[derive(Args, Debug, Clone)]
#[command(next_help_heading = "Messages")]
pub(crate) struct Say {
    /// Print one JSON object with the results instead of text
    #[arg(long)]
    pub json: bool,
    /// Only results and errors
    #[arg(short, long, conflicts_with = "verbose")]
    pub quiet: bool,
    /// More on standard error
    #[arg(short, long, action = clap::ArgAction::Count)]
    pub verbose: u8,
    /// Progress on standard error; auto: a bar on a terminal, plain lines otherwise, none with --json
    #[arg(long, value_enum, default_value_t = ProgressMode::Auto, value_name = "HOW")]
    pub progress: ProgressMode,
}

/// What every command that works on a volume takes.
#[derive(Args, Debug, Clone)]
pub(crate) struct Run {
    #[command(flatten)]
    pub limits: Limits,
    #[command(flatten)]
    pub say: Say,
}

/// Whether results may replace files.
#[derive(Args, Debug, Clone)]
pub(crate) struct Overwrite {
    /// Replace the output if it exists
    #[arg(long)]
    pub overwrite: bool,
}

/// Which part of a volume.
#[derive(Args, Debug, Clone)]
pub(crate) struct Region {
    /// Only this region, by index, half-open: x0:x1,y0:y1,z0:z1
    #[arg(long, value_name = "REGION", allow_hyphen_values = true, conflicts_with = "roi_world",
          value_parser = region)]
    pub roi: Option<Box3>,
    /// Only this region, in world units: x0:x1,y0:y1,z0:z1
    #[arg(long, value_name = "REGION", allow_hyphen_values = true,
          value_parser = parse::world_region)]
    pub roi_world: Option<[[f64; 2]; 3]>,
}

/// Which volume of a file, and how it is read.
#[derive(Args, Debug, Clone)]
#[command(next_help_heading = "Volume")]
pub(crate) struct Pick {
    /// Which volume of the file, by name [default: the first]
    #[arg(long, value_name = "NAME")]
    pub name: Option<String>,
    /// Level of detail: 0 is the volume itself, each further one has half as many samples per axis
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub level: u8,
    /// What to do where the file is damaged
    #[arg(long, value_enum, default_value_t = DamageMode::Error)]
    pub on_damage: DamageMode,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum DamageMode {
    /// Stop with an error that names the place
    Error,
    /// Go on with the background, or the nearest value the index allows, and report what was lost
    Substitute,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum ProgressMode {
    Auto,
    Bar,
    Plain,
    Json,
    None,
}

#[derive(Args, Debug)]
pub(crate) struct Demo {
    /// Folder for the results; made if it does not exist
    #[arg(default_value = "demo")]
    pub dir: PathBuf,
    /// Samples per edge of the large field
    #[arg(long, value_name = "N", default_value_t = 1024,
          value_parser = clap::value_parser!(u32).range(32..=4096))]
    pub size: u32,
    #[command(flatten)]
    pub overwrite: Overwrite,
    #[command(flatten)]
    pub run: Run,
}

#[derive(Args, Debug)]
pub(crate) struct Import {
    /// Source: raw, .npy, .nrrd, .nhdr, .nii, .nii.gz, .mha, .mhd (also with .gz)
    pub source: PathBuf,
    /// Volume file to write
    pub out: PathBuf,
    /// What the samples mean: density, distance, mask, label [default: what the source says]
    #[arg(long, value_name = "KIND", value_parser = kind)]
    pub kind: Option<Kind>,
    /// Samples per brick edge
    #[arg(long, value_name = "N", value_parser = ["8", "16", "32", "64"])]
    pub brick: Option<String>,
    /// Which volume of a series (4-D file), from 0
    #[arg(long, value_name = "N")]
    pub volume: Option<u32>,
    /// Value of the space that holds nothing
    #[arg(long, value_name = "V", allow_hyphen_values = true, value_parser = parse::finite)]
    pub background: Option<f64>,
    /// How to compress: fast decodes at gigabytes per second; small makes scans of 8 and 16 bits up to a tenth
    /// smaller and decodes slower
    #[arg(long, value_enum, default_value_t = CompressionMode::Fast)]
    pub compression: CompressionMode,
    /// Build up to this many coarser levels of detail
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub levels: u8,
    /// Go on with an import that was stopped, where OUT.partial keeps one
    #[arg(long)]
    pub resume: bool,
    #[command(flatten)]
    pub raw: RawSource,
    #[command(flatten)]
    pub overwrite: Overwrite,
    #[command(flatten)]
    pub run: Run,
}

/// How headerless samples are laid out.
#[derive(Args, Debug, Clone)]
#[command(next_help_heading = "Raw sources")]
pub(crate) struct RawSource {
    /// Samples along x, y, z (x fastest); needed for raw files
    #[arg(long, value_name = "X,Y,Z", value_parser = parse::dims, requires = "sample",
          allow_hyphen_values = true)]
    pub dims: Option<[u32; 3]>,
    /// Type of a sample: u8, i8, u16, i16, u32, i32, f32; needed for raw files
    #[arg(long = "type", value_name = "TYPE", value_parser = sample_type, requires = "dims", id = "sample")]
    pub sample: Option<SampleType>,
    /// Byte order
    #[arg(long, value_enum, default_value_t = Endian::Little, requires = "dims")]
    pub endian: Endian,
    /// World units per step along x, y, z
    #[arg(long, value_name = "DX,DY,DZ", value_parser = parse::spacing, requires = "dims",
          allow_hyphen_values = true)]
    pub spacing: Option<[f64; 3]>,
    /// Bytes before the first sample
    #[arg(long, value_name = "BYTES", default_value_t = 0, requires = "dims")]
    pub offset: u64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum CompressionMode {
    Fast,
    Small,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Endian {
    Little,
    Big,
}

#[derive(Args, Debug)]
pub(crate) struct Export {
    /// Volume file
    pub volume: PathBuf,
    /// File to write: .raw, .npy or .nrrd
    pub out: PathBuf,
    /// Compress the samples (NRRD only)
    #[arg(long)]
    pub gzip: bool,
    #[command(flatten)]
    pub pick: Pick,
    #[command(flatten)]
    pub region: Region,
    #[command(flatten)]
    pub overwrite: Overwrite,
    #[command(flatten)]
    pub run: Run,
}

#[derive(Args, Debug)]
pub(crate) struct Info {
    /// Volume file
    pub volume: PathBuf,
    /// Which volume of the file, by name [default: the first]
    #[arg(long, value_name = "NAME")]
    pub name: Option<String>,
    /// Read the samples: mean, deviation, and a histogram with this many bins
    #[arg(long, value_name = "BINS", num_args = 0..=1, default_missing_value = "32",
          value_parser = clap::value_parser!(u32).range(1..=65536))]
    pub histogram: Option<u32>,
    /// Values at the ends of the histogram [default: the smallest and largest]
    #[arg(long, value_name = "LO:HI", allow_hyphen_values = true, value_parser = parse::window,
          requires = "histogram")]
    pub window: Option<(f64, f64)>,
    #[command(flatten)]
    pub region: Region,
    #[command(flatten)]
    pub run: Run,
}

#[derive(Args, Debug)]
pub(crate) struct Verify {
    /// Volume file
    pub volume: PathBuf,
    #[command(flatten)]
    pub run: Run,
}

#[derive(Args, Debug)]
pub(crate) struct Compact {
    /// Volume file
    pub volume: PathBuf,
    /// File to write; may be the volume file itself, with --overwrite
    pub out: PathBuf,
    #[command(flatten)]
    pub overwrite: Overwrite,
    #[command(flatten)]
    pub run: Run,
}

#[derive(Args, Debug)]
pub(crate) struct Mesh {
    /// Volume file
    pub volume: PathBuf,
    /// Mesh to write: .ply, .stl or .obj
    pub out: PathBuf,
    /// The isovalue [default: 0 for a distance, 0.5 for a mask; a density has none]
    #[arg(long, value_name = "V", allow_hyphen_values = true, value_parser = parse::isovalue,
          visible_alias = "iso-value")]
    pub iso: Option<f32>,
    /// The surface of this segment of a label volume
    #[arg(long, value_name = "ID", conflicts_with = "iso")]
    pub label: Option<u32>,
    /// The surfaces of these segments of a label volume, in one pass: all (but 0), or 1,2,5; a file for each
    /// when OUT has {label} in its name, else one .ply whose faces have a label
    #[arg(long, value_name = "IDS", value_parser = parse::labels,
          conflicts_with_all = ["iso", "label", "seed", "inside", "simplify"])]
    pub labels: Option<parse::LabelList>,
    /// Smooth the mask of each segment before it is meshed: passes of the kernel 1/4, 1/2, 1/4
    #[arg(long, value_name = "N", default_value_t = 0, requires = "labels",
          conflicts_with_all = ["iso", "label", "seed", "inside"],
          value_parser = clap::value_parser!(u8).range(0..=4))]
    pub label_smooth: u8,
    #[command(flatten)]
    pub pick: Pick,
    #[command(flatten)]
    pub region: Region,
    /// Only the surface through this cell (its lowest corner, by index); may be repeated
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, value_parser = parse::triple::<i32>)]
    pub seed: Vec<[i32; 3]>,
    /// What happens where the surface leaves the region
    #[arg(long, value_enum, default_value_t = BoundaryMode::Cap)]
    pub boundary: BoundaryMode,
    /// Which side of the isovalue is inside [default: below for a distance, above otherwise]
    #[arg(long, value_enum)]
    pub inside: Option<InsideMode>,
    /// Only one component: the largest (by triangles), or the N-th largest; of each segment with --labels
    #[arg(long, value_name = "largest|N", value_parser = parse::component)]
    pub component: Option<u64>,
    /// Only components of at least this many triangles
    #[arg(long, value_name = "K", conflicts_with = "component")]
    pub min_triangles: Option<u64>,
    /// Make one part of the mesh, as 3/7, into OUT (.part); `join` makes the mesh of all of them
    #[arg(long, value_name = "I/N", value_parser = parse::part, conflicts_with_all = ["seed", "measure", "picture", "dry_run", "component", "min_triangles", "labels", "simplify"])]
    pub part: Option<[u32; 2]>,
    /// Measure the surface while it is made: area, volume, and whether it is closed
    #[arg(long)]
    pub measure: bool,
    /// Write unit normals, from the gradient of the samples
    #[arg(long)]
    pub normals: bool,
    /// Write the lattice edge of each vertex, by which pieces can be joined
    #[arg(long)]
    pub keys: bool,
    #[command(flatten)]
    pub smooth: Smooth,
    /// Fewer triangles: a share of them, or as few as an error in the units of the mesh allows
    #[arg(long, value_name = "N%|ERROR", value_parser = parse::simplify)]
    pub simplify: Option<parse::Simplify>,
    /// Colour the vertices (.ply, and the picture) by another volume where they are: by the volumes NAME.r, NAME.g and
    /// NAME.b [NAME: color], else by the values of volume NAME [default: the first]
    #[arg(long, value_name = "VOLUME[:NAME]", conflicts_with_all = ["part", "labels"])]
    pub color: Option<PathBuf>,
    /// Colour map of values [default: labels for a label volume, viridis otherwise]
    #[arg(long, value_enum, requires = "color")]
    pub color_map: Option<MapName>,
    /// Values at the ends of the colour map [default: the smallest and largest]
    #[arg(long, value_name = "LO:HI", allow_hyphen_values = true, value_parser = parse::window,
          requires = "color")]
    pub color_window: Option<(f64, f64)>,
    /// Coordinates of the mesh
    #[arg(long, value_enum, default_value_t = Space::World)]
    pub space: Space,
    /// Write a mesh without triangles when nothing crosses the isovalue, instead of failing
    #[arg(long)]
    pub allow_empty: bool,
    /// Say what would be read and how much memory it takes, and stop
    #[arg(long)]
    pub dry_run: bool,
    #[command(flatten)]
    pub shot: Shot,
    #[command(flatten)]
    pub overwrite: Overwrite,
    #[command(flatten)]
    pub run: Run,
}

#[derive(Args, Debug)]
pub(crate) struct Join {
    /// Mesh to write: .ply, .stl or .obj
    pub out: PathBuf,
    /// The parts, in any order
    #[arg(required = true)]
    pub parts: Vec<PathBuf>,
    /// Write a mesh without triangles when nothing crosses the isovalue, instead of failing
    #[arg(long)]
    pub allow_empty: bool,
    #[command(flatten)]
    pub overwrite: Overwrite,
    #[command(flatten)]
    pub run: Run,
}

#[derive(Args, Debug)]
pub(crate) struct Model {
    /// Scene file (TOML); docs/scenes.md says what it may contain
    pub scene: PathBuf,
    /// Volume (.bvol) or mesh (.ply, .stl, .obj) to write
    pub out: PathBuf,
    /// Cells along the longest edge of the scene's bounds [default: what the scene says, or 256]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1 << 20))]
    pub resolution: Option<u32>,
    /// Edge of a cell in world units, instead of --resolution
    #[arg(long, value_name = "S", value_parser = parse::finite, conflicts_with = "resolution")]
    pub voxel: Option<f64>,
    /// Volumes: half width of the band around the surface that keeps its values, in voxels
    #[arg(long, value_name = "VOXELS", default_value_t = 3.0, value_parser = parse::finite)]
    pub band: f64,
    /// Volumes: keep the value of every sample, near the surface or not
    #[arg(long, conflicts_with = "band")]
    pub full: bool,
    /// Meshes: write unit normals
    #[arg(long)]
    pub normals: bool,
    #[command(flatten)]
    pub smooth: Smooth,
    /// Meshes: move every vertex along its edge of the lattice onto the surface of the scene itself, not of its
    /// samples
    #[arg(long, conflicts_with = "smooth")]
    pub refine: bool,
    /// Meshes: fewer triangles: a share of them, or as few as an error in the units of the mesh allows
    #[arg(long, value_name = "N%|ERROR", value_parser = parse::simplify)]
    pub simplify: Option<parse::Simplify>,
    /// Write the colours of the scene: of each vertex (.ply), or as volumes color.r, color.g and color.b beside
    /// the first, with one for each other attribute (.bvol)
    #[arg(long)]
    pub colors: bool,
    /// Meshes: write one without triangles when the scene is empty, instead of failing
    #[arg(long)]
    pub allow_empty: bool,
    /// Print the tree of the scene and what it would take, and stop
    #[arg(long)]
    pub dry_run: bool,
    #[command(flatten)]
    pub shot: Shot,
    #[command(flatten)]
    pub overwrite: Overwrite,
    #[command(flatten)]
    pub run: Run,
}

/// Better triangles.
#[derive(Args, Debug, Clone)]
pub(crate) struct Smooth {
    /// Move vertices for better triangles: along the surface, at most half a cell along each axis
    #[arg(long, value_enum, value_name = "HOW")]
    pub smooth: Option<SmoothMode>,
    /// How often each vertex is moved
    #[arg(long, value_name = "N", default_value_t = 3, requires = "smooth",
          value_parser = clap::value_parser!(u8).range(1..=5))]
    pub passes: u8,
}

impl Smooth {
    /// Passes of relaxation, 0 for none.
    pub(crate) fn relax(&self) -> u8 {
        match self.smooth {
            Some(SmoothMode::Quality) => self.passes,
            None => 0,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum SmoothMode {
    /// No slivers; the surface stays where it is
    Quality,
}

/// A shaded picture of the surface, drawn while it is made.
/// How a surface is looked at.
#[derive(Args, Debug, Clone)]
pub(crate) struct Camera {
    /// Where to look from: azimuth,elevation in degrees; 0,0 looks along +y with z up
    #[arg(long, value_name = "A,E", default_value = "30,25", value_parser = parse::view,
          allow_hyphen_values = true)]
    pub view: [f64; 2],
    /// Colour of the surface
    #[arg(long, value_name = "RRGGBB", default_value = "e8d9be", value_parser = parse::colour)]
    pub colour: [u8; 3],
    /// Parallel projection instead of perspective
    #[arg(long)]
    pub parallel: bool,
}

#[derive(Args, Debug, Clone)]
#[command(next_help_heading = "Picture")]
pub(crate) struct Shot {
    /// Write a shaded picture of the surface too
    #[arg(long, value_name = "FILE.png")]
    pub picture: Option<PathBuf>,
    /// Size of the picture
    #[arg(long, value_name = "WxH", default_value = "1200x900", value_parser = parse::pixels)]
    pub picture_size: [u32; 2],
    #[command(flatten)]
    pub camera: Camera,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum BoundaryMode {
    /// Close the solid along the border
    Cap,
    /// Leave the surface open at the border
    Cut,
    /// Cap at the border of the volume, leave open at the border of the region, for joining
    Tile,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum InsideMode {
    /// Inside is value >= iso
    Above,
    /// Inside is value < iso
    Below,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Space {
    World,
    Index,
}

#[derive(Args, Debug)]
pub(crate) struct Check {
    /// Mesh: .ply, .stl or .obj
    pub mesh: PathBuf,
    /// A border is no fault
    #[arg(long)]
    pub open_ok: bool,
    /// Look for triangles that go through each other: all, none, or among about this many
    #[arg(long, value_name = "HOW", default_value = "4000000", value_parser = parse::crossings)]
    pub crossings: u64,
    /// Memory for the mesh, which is read whole where it fits; otherwise binary PLY is checked in parts
    #[arg(long, value_name = "SIZE", default_value = "4GiB", value_parser = parse::size)]
    pub mem: u64,
    /// Folder for scratch files, where a mesh is checked in parts [default: that of the mesh]
    #[arg(long, value_name = "DIR")]
    pub scratch: Option<PathBuf>,
    #[command(flatten)]
    pub say: Say,
}

#[derive(Args, Debug)]
pub(crate) struct Slice {
    /// Volume file
    pub volume: PathBuf,
    /// Picture to write: .png, or .svg, whose isolines are paths
    pub out: PathBuf,
    /// Axis that the slice is perpendicular to (by index)
    #[arg(long, value_enum, default_value_t = Axis::Z)]
    pub axis: Axis,
    /// Which slice, by index [default: the middle]
    #[arg(
        long,
        value_name = "N",
        allow_hyphen_values = true,
        conflicts_with = "position"
    )]
    pub index: Option<i32>,
    /// Which slice, by world coordinate; the nearest one is taken
    #[arg(long, value_name = "W", allow_hyphen_values = true, value_parser = parse::finite)]
    pub position: Option<f64>,
    /// A plane in any direction: the direction in which to look; docs/guide.md says what is up
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, value_parser = parse::point,
          conflicts_with_all = ["axis", "index", "position", "through"])]
    pub normal: Option<[f64; 3]>,
    /// A point of the plane of --normal [default: the middle of the region]
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, value_parser = parse::point,
          requires = "normal")]
    pub origin: Option<[f64; 3]>,
    /// What is up in the picture of --normal [default: z, or -y where one looks along z]
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, value_parser = parse::point,
          requires = "normal")]
    pub up: Option<[f64; 3]>,
    /// The plane through three points, given one after another: the second to the right, the third above
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, value_parser = parse::point,
          conflicts_with_all = ["axis", "index", "position"])]
    pub through: Vec<[f64; 3]>,
    /// Coordinates of --normal, --origin, --up and --through
    #[arg(long, value_enum, default_value_t = Space::World)]
    pub space: Space,
    /// How a plane of any direction is read between samples [default: nearest for labels, else trilinear]
    #[arg(long, value_enum, conflicts_with_all = ["axis", "index", "position"])]
    pub method: Option<MethodName>,
    /// Values shown as black and white [default: the 0.5th and 99.5th percentile]
    #[arg(long, value_name = "LO:HI", allow_hyphen_values = true, value_parser = parse::window)]
    pub window: Option<(f64, f64)>,
    /// The same as their difference and their middle
    #[arg(long, value_name = "WIDTH,LEVEL", allow_hyphen_values = true, value_parser = parse::window_level,
          conflicts_with = "window")]
    pub window_level: Option<[f64; 2]>,
    /// Colour map [default: labels for a label volume, grey otherwise]
    #[arg(long, value_enum)]
    pub map: Option<MapName>,
    /// Pixels per sample along the finer axis
    #[arg(long, value_name = "S", default_value = "1", value_parser = scale)]
    pub scale: f64,
    /// Draw the lines along which the values are V; may be repeated
    #[arg(long, value_name = "V", allow_hyphen_values = true, value_parser = parse::isovalue)]
    pub iso: Vec<f32>,
    /// Width of the lines in pixels
    #[arg(long, value_name = "PIXELS", default_value = "1.5", value_parser = line_width)]
    pub line_width: f64,
    /// Colour of all lines [default: another for each value]
    #[arg(long, value_name = "RRGGBB", value_parser = parse::colour)]
    pub line_colour: Option<[u8; 3]>,
    /// Draw a bar of a round length
    #[arg(long)]
    pub scale_bar: bool,
    /// SVG: lines and scale bar only
    #[arg(long)]
    pub no_image: bool,
    #[command(flatten)]
    pub pick: Pick,
    #[command(flatten)]
    pub region: Region,
    #[command(flatten)]
    pub overwrite: Overwrite,
    #[command(flatten)]
    pub run: Run,
}

#[derive(Args, Debug)]
pub(crate) struct Sample {
    /// Volume file
    pub volume: PathBuf,
    /// Points: .csv with x,y,z in each line, or .npy of shape (N, 3)
    pub points: PathBuf,
    /// File to write, .csv or .npy: x, y, z, value [default: CSV on standard output]
    #[arg(short, long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// How values between samples are found
    #[arg(long, value_enum, default_value_t = MethodName::Trilinear)]
    pub method: MethodName,
    /// Add the gradient, per unit of the coordinates: gx, gy, gz
    #[arg(long)]
    pub gradient: bool,
    /// Coordinates of the points
    #[arg(long, value_enum, default_value_t = Space::World)]
    pub space: Space,
    /// Value outside of the samples
    #[arg(
        long,
        value_name = "V",
        default_value = "nan",
        allow_hyphen_values = true
    )]
    pub outside: f32,
    #[command(flatten)]
    pub pick: Pick,
    #[command(flatten)]
    pub overwrite: Overwrite,
    #[command(flatten)]
    pub run: Run,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum MethodName {
    /// The nearest sample
    Nearest,
    /// Linear along each axis
    Trilinear,
    /// Cubic along each axis, smooth, through the samples
    Tricubic,
}

impl From<MethodName> for Method {
    fn from(name: MethodName) -> Method {
        match name {
            MethodName::Nearest => Method::Nearest,
            MethodName::Trilinear => Method::Trilinear,
            MethodName::Tricubic => Method::Tricubic,
        }
    }
}

#[derive(Args, Debug)]
pub(crate) struct Ray {
    /// Volume file
    pub volume: PathBuf,
    /// Rays: .csv with x,y,z,dx,dy,dz in each line, or .npy of shape (N, 6)
    pub rays: PathBuf,
    /// File to write, .csv or .npy [default: CSV on standard output]
    #[arg(short, long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    #[command(flatten)]
    pub what: RayWhat,
    /// Coordinates of the rays
    #[arg(long, value_enum, default_value_t = Space::World)]
    pub space: Space,
    #[command(flatten)]
    pub pick: Pick,
    #[command(flatten)]
    pub region: Region,
    #[command(flatten)]
    pub overwrite: Overwrite,
    #[command(flatten)]
    pub run: Run,
}

/// What is asked of a ray.
#[derive(Args, Debug, Clone)]
#[group(required = true, multiple = false)]
pub(crate) struct RayWhat {
    /// The first crossing of this value: t, x, y, z, and 1 where the values rise
    #[arg(long, value_name = "V", allow_hyphen_values = true, value_parser = parse::isovalue)]
    pub iso: Option<f32>,
    /// The largest value: t, x, y, z, value
    #[arg(long)]
    pub max: bool,
    /// The integral of the values over length, and the length that has values
    #[arg(long)]
    pub integral: bool,
}

#[derive(Args, Debug)]
pub(crate) struct Render {
    /// Volume file, or scene file (.toml)
    pub volume: PathBuf,
    /// Picture to write (.png)
    pub out: PathBuf,
    /// The surface of this isovalue [default: 0 for a distance, 0.5 for a mask]
    #[arg(long, value_name = "V", allow_hyphen_values = true, value_parser = parse::isovalue,
          conflicts_with_all = ["fog", "max"])]
    pub iso: Option<f32>,
    /// Which side of the isovalue is inside [default: below for a distance, above otherwise]
    #[arg(long, value_enum)]
    pub inside: Option<InsideMode>,
    /// The density as a fog, between the values of --window
    #[arg(long, conflicts_with = "max")]
    pub fog: bool,
    /// The largest value along each ray
    #[arg(long)]
    pub max: bool,
    /// Values that are clear and of full strength [default: what the volume has]
    #[arg(long, value_name = "LO:HI", allow_hyphen_values = true, value_parser = parse::window)]
    pub window: Option<(f64, f64)>,
    /// Fog: part of the light that a step of the lattice takes away at full strength
    #[arg(long, value_name = "PART", default_value_t = 0.1, value_parser = parse::finite)]
    pub opacity: f64,
    /// Colour map of fog and largest values
    #[arg(long, value_enum, default_value_t = MapName::Grey)]
    pub map: MapName,
    /// Leave hollows as bright as the rest
    #[arg(long)]
    pub no_occlusion: bool,
    /// Size of the picture
    #[arg(long, value_name = "WxH", default_value = "1200x900", value_parser = parse::pixels)]
    pub size: [u32; 2],
    #[command(flatten)]
    pub camera: Camera,
    /// Scenes: cells along the longest edge [default: what the scene says, or 256]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1 << 20))]
    pub resolution: Option<u32>,
    #[command(flatten)]
    pub pick: Pick,
    #[command(flatten)]
    pub region: Region,
    #[command(flatten)]
    pub overwrite: Overwrite,
    #[command(flatten)]
    pub run: Run,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Axis {
    X,
    Y,
    Z,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum MapName {
    /// Black to white
    Grey,
    /// Dark violet to yellow, even to the eye
    Viridis,
    /// Black through red to pale yellow
    Inferno,
    /// Blue, white, red, for values around a middle
    Diverging,
    /// A colour of its own for each value
    Labels,
}

#[derive(Args, Debug)]
pub(crate) struct Batch {
    /// Job file (TOML); docs/guide.md says what it may contain
    pub file: PathBuf,
    /// Tasks at one time [default: what the job file says, or as many as have a core and 48 MiB each]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub jobs: Option<u16>,
    /// Print the plan, with the memory of each task and what is finished, and stop
    #[arg(long)]
    pub dry_run: bool,
    #[command(flatten)]
    pub run: Run,
}

#[cfg(feature = "serve")]
#[derive(Args, Debug)]
pub(crate) struct Serve {
    /// Volume files; nothing else can be reached
    #[arg(required = true)]
    pub volumes: Vec<PathBuf>,
    /// Address to listen on; port 0 takes a free one. Anyone who can reach it can read the volumes
    #[arg(long, value_name = "ADDRESS:PORT", default_value = "127.0.0.1:8400")]
    pub listen: std::net::SocketAddr,
    /// Largest region, slice or mesh in one answer
    #[arg(long, value_name = "SIZE", default_value = "256MiB", value_parser = parse::size)]
    pub max_region_bytes: u64,
    /// Folder for meshes while they are sent [default: the system's folder for temporary files]
    #[arg(long, value_name = "DIR")]
    pub scratch: Option<PathBuf>,
    #[command(flatten)]
    pub run: Run,
}

#[derive(Args, Debug)]
pub(crate) struct Completions {
    /// bash, elvish, fish, powershell or zsh
    pub shell: clap_complete::Shell,
}

#[derive(Args, Debug)]
pub(crate) struct Man {
    /// Folder for brickmarch.1 and one page per command
    pub dir: PathBuf,
}

fn region(text: &str) -> Result<Box3, String> {
    text.parse().map_err(|e: brickmarch::Error| e.to_string())
}

fn kind(text: &str) -> Result<Kind, String> {
    match text.parse() {
        Ok(Kind::Color) => Err("'color' volumes cannot be imported yet".to_string()),
        other => other.map_err(|e: brickmarch::Error| e.to_string()),
    }
}

fn sample_type(text: &str) -> Result<SampleType, String> {
    text.parse().map_err(|e: brickmarch::Error| e.to_string())
}

fn line_width(text: &str) -> Result<f64, String> {
    let value = parse::finite(text)?;
    if (0.1..=64.0).contains(&value) {
        Ok(value)
    } else {
        Err(format!("'{text}': the width must be from 0.1 to 64"))
    }
}

fn scale(text: &str) -> Result<f64, String> {
    let value = parse::finite(text)?;
    if (0.01..=64.0).contains(&value) {
        Ok(value)
    } else {
        Err(format!("'{text}': the scale must be from 0.01 to 64"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn the_definition_is_consistent() {
        Cli::command().debug_assert();
    }

    #[test]
    fn negative_numbers_are_values() {
        let line =
            "brickmarch mesh a.bvol b.ply --iso -500 --seed -1,2,3 --seed 4,5,6 --roi -3:4,0:1,0:1";
        let cli = Cli::try_parse_from(line.split_whitespace()).expect("parses");
        let Command::Mesh(mesh) = cli.command else {
            panic!("mesh")
        };
        assert_eq!(mesh.iso, Some(-500.0));
        assert_eq!(mesh.seed, [[-1, 2, 3], [4, 5, 6]]);
        assert_eq!(mesh.region.roi, Some(Box3::new([-3, 0, 0], [4, 1, 1])));
        assert_eq!(mesh.run.limits.mem, 256 << 20);
    }
}
