//! Data files as shapes: volumes, other formats, height fields.

use super::keys::Keys;
use super::shapes::convention;
use super::value::Value;
use crate::{OpenOptions, RawLayout, open_volume};
use brickmarch::field::Dense;
use brickmarch::model::{Convention, Primitive, Sampled};
use brickmarch::redistance::Redistanced;
use brickmarch::store::{self, Volume, VolumeSpec};
use brickmarch::{Affine, Box3, Budget, Field, Grid, Kind, Result, SampleType, Units};
use std::path::Path;
use std::sync::Arc;

/// Most heights in a scene file.
const MAX_HEIGHTS: usize = 1 << 20;

/// # Errors
/// Names line and key.
pub(super) fn volume(keys: &Keys<'_>) -> Result<Primitive> {
    let (field, name) = open(keys)?;
    if let Some(band) = keys.number("redistance")? {
        return redistanced(keys, field, &name, band);
    }
    let default = match field.kind() {
        Kind::Distance => "distance",
        _ => "density",
    };
    let mask = field.kind() == Kind::Mask && keys.get("iso").is_none();
    let convention = if mask && keys.get("as").is_none() {
        Convention::Density { iso: 0.5 }
    } else {
        convention(keys, default)?
    };
    let samples =
        Sampled::new(field, &name).map_err(|e| keys.scope.error(keys.line, e.to_string()))?;
    Ok(Primitive::Sampled {
        samples,
        convention,
    })
}

/// The distance to the surface of a field, made once into a temporary volume.
fn redistanced(
    keys: &Keys<'_>,
    field: Arc<dyn Field + Send + Sync>,
    name: &str,
    band: f64,
) -> Result<Primitive> {
    let wrong = |e: brickmarch::Error| keys.scope.error(keys.line, format!("{name}: {e}"));
    let line = keys.get("redistance").map_or(keys.line, |i| i.line);
    let of_band = |e: brickmarch::Error| keys.scope.error(line, format!("'redistance': {e}"));
    if keys.get("as").is_some() {
        return Err(keys.scope.error(
            line,
            "'redistance' makes a distance: leave 'as' out".to_string(),
        ));
    }
    let iso = match field.kind() {
        Kind::Distance => keys.number_or("iso", 0.0)?,
        Kind::Mask => keys.number_or("iso", 0.5)?,
        _ => keys.need_number("iso")?,
    };
    let budget = &keys.scope.budget;
    let near = Redistanced::new(field.as_ref(), iso as f32, None, band, budget).map_err(of_band)?;
    let mut spec = VolumeSpec::new(*near.grid(), SampleType::F32);
    spec.kind = Kind::Distance;
    spec.background = band;
    let folder = scratch_folder(Path::new(name)).map_err(wrong)?;
    let path = folder.path().join("distance.bvol");
    store::write_field(&near, &spec, &path, budget).map_err(wrong)?;
    let volume = Volume::open(&path, budget).map_err(wrong)?;
    let scratch = Arc::new(Scratch {
        volume,
        _folder: folder,
    });
    let samples = Sampled::new(scratch, name).map_err(wrong)?;
    Ok(Primitive::Sampled {
        samples,
        convention: Convention::Distance,
    })
}

fn scratch_folder(path: &Path) -> Result<tempfile::TempDir> {
    tempfile::tempdir()
        .map_err(|e| brickmarch::Error::io(path, "making a temporary folder for its samples", e))
}

fn open(keys: &Keys<'_>) -> Result<(Arc<dyn Field + Send + Sync>, String)> {
    let line = keys.need("file")?.line;
    let file = keys.text("file")?.unwrap_or_default();
    let path = keys.scope.beside(file);
    let raw = match keys.vector("dims")? {
        None => None,
        Some(dims) => Some(raw_layout(keys, dims)?),
    };
    let opened = open_field(&path, raw, &keys.scope.budget);
    let field = opened.map_err(|e| keys.scope.error(line, e.to_string()))?;
    Ok((field, file.to_string()))
}

fn raw_layout(keys: &Keys<'_>, dims: [f64; 3]) -> Result<RawLayout> {
    if dims.iter().any(|d| *d != d.trunc() || *d < 1.0 || *d > 1e9) {
        return Err(keys.scope.error(
            keys.line,
            format!("'dims' is {dims:?}: give three whole numbers from 1"),
        ));
    }
    keys.need("type")?;
    let sample: SampleType = keys
        .text("type")?
        .unwrap_or_default()
        .parse()
        .map_err(|e: brickmarch::Error| keys.scope.error(keys.line, e.to_string()))?;
    Ok(RawLayout {
        dims: dims.map(|d| d as u32),
        sample,
        big_endian: keys.choice("endian", &["little", "big"])? == Some("big"),
        spacing: keys.vector("spacing")?.unwrap_or([1.0; 3]),
        offset: u64::from(keys.whole("skip", u32::MAX)?.unwrap_or(0)),
    })
}

/// A volume as it is; any other format by way of a temporary volume, which gives it ranges and
/// keeps memory small.
fn open_field(
    path: &Path,
    raw: Option<RawLayout>,
    budget: &Budget,
) -> Result<Arc<dyn Field + Send + Sync>> {
    let is_volume = path
        .extension()
        .is_some_and(|e| e.eq_ignore_ascii_case("bvol"));
    if is_volume && raw.is_none() {
        return Ok(Arc::new(Volume::open(path, budget)?));
    }
    let options = OpenOptions { volume: None, raw };
    let mut source = open_volume(path, &options)?;
    let mut spec = VolumeSpec::new(source.grid, source.sample);
    spec.kind = source.kind;
    spec.background = source.background;
    let scratch = scratch_folder(path)?;
    let copy = scratch.path().join("leaf.bvol");
    store::import_stream(&mut source.reader, &spec, &copy, budget)?;
    let volume = Volume::open(&copy, budget)?;
    Ok(Arc::new(Scratch {
        volume,
        _folder: scratch,
    }))
}

/// A volume whose file goes when it does.
struct Scratch {
    volume: Volume,
    _folder: tempfile::TempDir,
}

impl Field for Scratch {
    fn grid(&self) -> &Grid {
        self.volume.grid()
    }

    fn kind(&self) -> Kind {
        self.volume.kind()
    }

    fn read(&self, region: Box3, out: &mut brickmarch::Samples<'_>) -> Result<()> {
        self.volume.read(region, out)
    }

    fn range(&self, region: Box3) -> Result<brickmarch::Range> {
        self.volume.range(region)
    }
}

/// Heights from a file with one sample along z, or from `values`, rows of y from the lowest.
///
/// # Errors
/// Names line and key.
pub(super) fn heights(keys: &Keys<'_>) -> Result<Primitive> {
    let factor = keys.number_or("factor", 1.0)?;
    let (field, name): (Arc<dyn Field + Send + Sync>, String) = if keys.get("file").is_some() {
        open(keys)?
    } else {
        (Arc::new(table(keys)?), "values".to_string())
    };
    if field.grid().domain.size()[2] != 1 {
        return Err(keys.scope.error(
            keys.line,
            format!(
                "heights need one sample along z; {name} has the domain {}: give a flat file",
                field.grid().domain
            ),
        ));
    }
    let heights =
        Sampled::new(field, &name).map_err(|e| keys.scope.error(keys.line, e.to_string()))?;
    Ok(Primitive::Heights { heights, factor })
}

fn table(keys: &Keys<'_>) -> Result<Dense> {
    keys.need("values")?;
    let rows = keys.list("values")?.unwrap_or_default();
    let mut values = Vec::new();
    let mut width = None;
    for row in rows {
        let Value::List(list) = &row.value else {
            return Err(keys.scope.error(
                row.line,
                "'values' holds no list: give rows of numbers, as in [[0, 1], [1, 2]]".into(),
            ));
        };
        if *width.get_or_insert(list.len()) != list.len() || list.is_empty() {
            return Err(keys.scope.error(
                row.line,
                format!(
                    "'values': a row of {} numbers among others: give every row the same number",
                    list.len()
                ),
            ));
        }
        for item in list {
            values.push(keys.scope.number("values", item)? as f32);
        }
        if values.len() > MAX_HEIGHTS {
            return Err(keys.scope.error(
                row.line,
                format!("more than {MAX_HEIGHTS} heights: put them in a file"),
            ));
        }
    }
    let width = width.unwrap_or(0);
    if width == 0 {
        return Err(keys
            .scope
            .error(keys.line, "'values' is empty: give rows of numbers".into()));
    }
    let spacing = keys.number_or("spacing", 1.0)?;
    let origin = match keys.get("origin") {
        Some(item) => keys.scope.numbers::<2>("origin", item)?,
        None => [0.0; 2],
    };
    if spacing.is_nan() || spacing < 1e-30 {
        return Err(keys.scope.error(
            keys.line,
            format!("'spacing' is {spacing}: give a number above 0"),
        ));
    }
    let grid = Grid {
        domain: Box3::from_size([width as i32, rows.len() as i32, 1]),
        index_to_world: Affine::from_spacing([spacing; 3], [origin[0], origin[1], 0.0]),
        units: Units::Unknown,
    };
    Dense::new(grid, values)
}
