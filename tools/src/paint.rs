//! Colours of points from a volume: trilinear, of three channels or of one through a colour map.

use crate::args::MapName;
use crate::cmd::open_named;
use crate::colourmap;
use crate::picture::Picture;
use crate::render::Raster;
use brickmarch::mesh::{Layout, Piece, Totals};
use brickmarch::query::{Cursor, Method};
use brickmarch::store::Volume;
use brickmarch::{Affine, Box3, Budget, Error, Field, Kind, MeshSink, Result};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Condvar, Mutex};

/// Part of the memory that is for the volumes of colours: the fourth.
pub(crate) const SHARE: u64 = 4;
/// The volumes of a file whose samples are colours.
const CHANNELS: [&str; 3] = ["r", "g", "b"];
/// Their name where none is given, as `model --colors` calls them.
const COLOUR: &str = "color";
/// How far beyond the samples the outermost one goes on, in cells: caps lie there.
const BEYOND: f64 = 1.0;

/// What colours are made of: three volumes, or one.
pub(crate) struct Paint {
    path: PathBuf,
    volumes: Vec<Volume>,
    /// Of the only one.
    map: MapName,
    window: (f64, f64),
    /// From the coordinates of the points to the world.
    to_world: Affine,
    to_index: Affine,
    budgets: Vec<Budget>,
    threads: usize,
}

impl Paint {
    /// Opens `VOLUME` or `VOLUME:NAME`: the volumes `NAME.r`, `NAME.g` and `NAME.b`, or `color.r` and so on where no name
    /// is given, if they are there; else the one that is named, or the first.
    ///
    /// # Errors
    /// A file that cannot be read, no such volume, channels that do not match, options for three volumes that
    /// only one can have.
    ///
    /// # Memory
    /// `bytes`, shared by the volumes and their readers.
    pub(crate) fn open(
        asked: &Path,
        map: Option<MapName>,
        window: Option<(f64, f64)>,
        to_world: Affine,
        bytes: u64,
        threads: usize,
    ) -> Result<Paint> {
        let (path, name) = file_and_name(asked);
        let one = Budget::bytes(bytes);
        let names = open_named(&path, None, &one)?.names().to_vec();
        let channels = CHANNELS.map(|c| format!("{}.{c}", name.as_deref().unwrap_or(COLOUR)));
        let is_named = name.as_ref().is_some_and(|n| names.contains(n));
        let in_colour = !is_named && channels.iter().all(|c| names.contains(c));
        let (mut volumes, mut budgets) = (Vec::new(), Vec::new());
        if in_colour {
            if map.is_some() || window.is_some() {
                return Err(Error::bad_input(format!(
                    "{}: '{}' and its like are colours already: leave --color-map and --color-window out, or name \
                     another volume",
                    path.display(),
                    channels[0]
                )));
            }
            for channel in &channels {
                let share = Budget::bytes(bytes / 3);
                volumes.push(open_named(&path, Some(channel), &share)?);
                budgets.push(share);
            }
            let [red, rest @ ..] = &volumes[..] else {
                unreachable!("three were opened")
            };
            if rest.iter().any(|v| v.grid() != red.grid()) {
                return Err(Error::bad_input(format!(
                    "{}: '{}' and its like are not on one grid: write the three of them anew",
                    path.display(),
                    channels[0]
                )));
            }
        } else {
            volumes.push(open_named(&path, name.as_deref(), &one)?);
            budgets.push(one);
        }
        let first = &volumes[0];
        let is_label = first.kind() == Kind::Label;
        let map = map.unwrap_or(if is_label {
            MapName::Labels
        } else {
            MapName::Viridis
        });
        let window = match window {
            Some(window) => window,
            None if in_colour || map == MapName::Labels => (0.0, 1.0),
            None => own_window(first, &path)?,
        };
        let to_index = first.grid().index_to_world.inverse()?;
        Ok(Paint {
            path,
            volumes,
            map,
            window,
            to_world,
            to_index,
            budgets,
            threads,
        })
    }

    /// A brush for many threads; what has no colour gets `plain`.
    ///
    /// # Errors
    /// When not even one thread has room.
    ///
    /// # Memory
    /// A cursor a volume and thread, of as many threads as have room.
    pub(crate) fn brush(&self, plain: [u8; 3]) -> Result<Brush<'_>> {
        let mut free = Vec::new();
        for n in 0..self.threads.max(1) {
            let cursors: Result<Vec<Cursor<'_>>> = (self.volumes.iter().zip(&self.budgets))
                .map(|(volume, budget)| Cursor::new(volume, budget))
                .collect();
            match cursors {
                Ok(cursors) => free.push(cursors),
                Err(e) if n == 0 => return Err(e.context(self.path.display())),
                Err(_) => break,
            }
        }
        Ok(Brush {
            paint: self,
            plain,
            free: Mutex::new(free),
            returned: Condvar::new(),
        })
    }
}

/// The file and the name in it; a file whose name has a colon is taken as it is.
fn file_and_name(asked: &Path) -> (PathBuf, Option<String>) {
    if !asked.exists()
        && let Some(text) = asked.to_str()
        && let Some((file, name)) = text.rsplit_once(':')
        && Path::new(file).exists()
    {
        return (file.into(), Some(name.to_string()));
    }
    (asked.to_path_buf(), None)
}

/// From the smallest to the largest value.
fn own_window(volume: &Volume, path: &Path) -> Result<(f64, f64)> {
    let range = volume.range(volume.grid().domain)?;
    let (low, high) = (f64::from(range.min), f64::from(range.max));
    if !(low.is_finite() && high.is_finite()) {
        return Err(Error::bad_input(format!(
            "{}: the values reach from {low} to {high}: give --color-window LO:HI",
            path.display()
        )));
    }
    Ok(if low < high {
        (low, high)
    } else {
        (low - 0.5, high + 0.5)
    })
}

/// Gives the colours of points, to any thread. A colour depends on nothing but its point.
pub(crate) struct Brush<'a> {
    paint: &'a Paint,
    plain: [u8; 3],
    free: Mutex<Vec<Vec<Cursor<'a>>>>,
    returned: Condvar,
}

impl Brush<'_> {
    /// Colours of points, `None` where there is none: more than a cell beyond the samples, no number, no segment.
    ///
    /// # Errors
    /// What the volumes report.
    fn found(&self, points: &mut dyn Iterator<Item = [f32; 3]>) -> Result<Vec<Option<[u8; 3]>>> {
        let mut cursors = {
            let mut free = self.free.lock().expect("no holder panics");
            loop {
                match free.pop() {
                    Some(cursors) => break cursors,
                    None => free = self.returned.wait(free).expect("no holder panics"),
                }
            }
        };
        let colours = points.map(|p| self.colour(&mut cursors, p)).collect();
        self.free.lock().expect("no holder panics").push(cursors);
        self.returned.notify_one();
        colours
    }

    fn colour(&self, cursors: &mut [Cursor<'_>], point: [f32; 3]) -> Result<Option<[u8; 3]>> {
        let paint = self.paint;
        let world = paint.to_world.apply(point.map(f64::from));
        let index = paint.to_index.apply(world);
        let Some(index) = held(index, paint.volumes[0].grid().domain) else {
            return Ok(None);
        };
        let method = match paint.map {
            MapName::Labels if cursors.len() == 1 => Method::Nearest,
            _ => Method::Trilinear,
        };
        let mut values = [0.0f32; 3];
        for (value, cursor) in values.iter_mut().zip(cursors.iter_mut()) {
            let read = cursor.value(index, method);
            let read = read.map_err(|e| e.context(paint.path.display()))?;
            match read {
                Some(v) if !v.is_nan() => *value = v,
                _ => return Ok(None),
            }
        }
        if cursors.len() == 3 {
            return Ok(Some(values.map(|v| (v + 0.5).clamp(0.0, 255.0) as u8)));
        }
        if paint.map == MapName::Labels {
            let label = values[0].abs() as u32;
            return Ok((label > 0).then(|| colourmap::label(label)));
        }
        let (low, high) = paint.window;
        let place = (f64::from(values[0]) - low) / (high - low);
        Ok(Some(colourmap::colour(paint.map, place as f32)))
    }

    /// Colours of points, the plain one where there is none.
    ///
    /// # Errors
    /// What the volumes report.
    pub(crate) fn colours(&self, points: &[[f32; 3]]) -> Result<Vec<[u8; 3]>> {
        let found = self.found(&mut points.iter().copied())?;
        Ok(found.into_iter().map(|c| c.unwrap_or(self.plain)).collect())
    }
}

impl Brush<'_> {
    /// What was drawn, in these colours.
    ///
    /// # Errors
    /// What the volumes and shading report.
    pub(crate) fn picture(&self, raster: &Raster, budget: &Budget) -> Result<Picture> {
        let failed = Mutex::new(None);
        let colours = |points: &[[f32; 3]]| {
            self.colours(points).unwrap_or_else(|e| {
                *failed.lock().expect("no holder panics") = Some(e);
                vec![[0; 3]; points.len()]
            })
        };
        let picture = raster.painted(Some(&colours), budget)?;
        match failed.into_inner().expect("no holder panics") {
            Some(e) => Err(e),
            None => Ok(picture),
        }
    }
}

/// The position, moved back to the samples where it is not far from them.
fn held(index: [f64; 3], domain: Box3) -> Option<[f64; 3]> {
    let ends = |a: usize| (f64::from(domain.min[a]), f64::from(domain.max[a] - 1));
    let near = |a: usize| {
        let (low, high) = ends(a);
        (low - BEYOND..=high + BEYOND).contains(&index[a])
    };
    (near(0) && near(1) && near(2)).then(|| {
        std::array::from_fn(|a| {
            let (low, high) = ends(a);
            index[a].clamp(low, high)
        })
    })
}

/// Gives the vertices of a mesh their colours on the way to a sink that writes them.
pub(crate) struct Painted<'a> {
    inner: Box<dyn MeshSink>,
    brush: &'a Brush<'a>,
    plain: AtomicU64,
}

impl<'a> Painted<'a> {
    pub(crate) fn new(inner: Box<dyn MeshSink>, brush: &'a Brush<'a>) -> Self {
        Self {
            inner,
            brush,
            plain: AtomicU64::new(0),
        }
    }

    /// Vertices that have got the plain colour.
    pub(crate) fn plain(&self) -> u64 {
        self.plain.load(Ordering::Relaxed)
    }
}

impl MeshSink for Painted<'_> {
    fn capacity(&self) -> Totals {
        self.inner.capacity()
    }

    fn begin(&mut self, layout: Layout) -> Result<()> {
        self.inner.begin(layout)
    }

    fn write(&self, piece: &Piece) -> Result<()> {
        // Vertices of other pieces are coloured there.
        let own = piece.own.iter().map(|&v| v as usize);
        let mut points = own.clone().map(|v| piece.positions[v]);
        let found = self.brush.found(&mut points)?;
        let mut painted = piece.clone();
        painted.colors = vec![self.brush.plain; piece.positions.len()];
        let mut plain = 0;
        for (v, colour) in own.zip(found) {
            match colour {
                Some(colour) => painted.colors[v] = colour,
                None => plain += 1,
            }
        }
        self.plain.fetch_add(plain, Ordering::Relaxed);
        self.inner.write(&painted)
    }

    fn finish(&mut self, totals: Totals) -> Result<()> {
        self.inner.finish(totals)
    }
}
