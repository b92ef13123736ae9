//! What a volume is before it has samples, and what is known of one that is finished.

use super::layout::{MAX_BRICKS, MAX_DIM, MAX_HISTORY, MAX_NAME, is_brick_edge};
use super::value::exact_bits_of;
use crate::error::{Error, ErrorKind, Result};
use crate::field::Range;
use crate::lattice::{Box3, Grid};
use crate::sample::{Kind, SampleType};

/// What the encoder of bricks chooses by. Reading needs no setting.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Compression {
    /// Codecs that decode at gigabytes per second; samples of one byte get an entropy coder, which decodes
    /// several times slower, where it saves an eighth of a brick.
    #[default]
    Fast,
    /// The smallest file: samples of 8 and 16 bits get an entropy coder, which makes a scan up
    /// to a tenth smaller and decodes several times slower. Other samples as `Fast`.
    Small,
}

/// What a volume is: where its samples are and what they mean.
#[derive(Clone, Debug, PartialEq)]
pub struct VolumeSpec {
    /// Domain and place in the world.
    pub grid: Grid,
    /// Type of the stored samples.
    pub sample: SampleType,
    /// What the samples mean.
    pub kind: Kind,
    /// Value of every sample that was never written.
    pub background: f64,
    /// Edge of the bricks: 8, 16, 32 or 64; see [`default_brick_edge`].
    pub brick_edge: u32,
    /// Free text: where the volume came from and what was done to it.
    pub history: String,
    /// Name of the volume inside the file.
    pub name: String,
}

/// The brick edge that suits most volumes of a sample type.
///
/// 16 for wide samples: fine pruning and small region reads; 32 for bytes and bits, whose bricks
/// would be too small to be worth a record. The measurement is in `docs/why.md`.
pub fn default_brick_edge(sample: SampleType) -> u32 {
    match sample {
        SampleType::Bit | SampleType::U8 | SampleType::I8 => 32,
        _ => 16,
    }
}

impl VolumeSpec {
    /// A density volume with the default brick edge, background 0 and no texts.
    pub fn new(grid: Grid, sample: SampleType) -> Self {
        Self {
            grid,
            sample,
            kind: Kind::Density,
            background: 0.0,
            brick_edge: default_brick_edge(sample),
            history: String::new(),
            name: String::new(),
        }
    }

    /// Bricks per axis; brick `[0, 0, 0]` starts at the smallest point of the domain.
    pub fn bricks(&self) -> [u32; 3] {
        self.grid.domain.size().map(|n| n.div_ceil(self.brick_edge))
    }

    /// # Errors
    /// `BadInput` or `LimitExceeded`, naming the field and its limit.
    pub fn validate(&self) -> Result<()> {
        let domain = self.grid.domain;
        if domain.is_empty() {
            return Err(Error::bad_input(format!(
                "the domain {domain} has no samples"
            )));
        }
        if !is_brick_edge(self.brick_edge) {
            return Err(Error::bad_input(format!(
                "brick edge {}: use 8, 16, 32 or 64",
                self.brick_edge
            )));
        }
        let longest = domain.size().into_iter().max().unwrap_or(0);
        if longest > MAX_DIM || longest.div_ceil(self.brick_edge) > MAX_BRICKS {
            return Err(Error::new(
                ErrorKind::LimitExceeded,
                format!(
                    "{longest} samples along an axis: the format holds {MAX_DIM}, and {MAX_BRICKS} bricks of edge {}",
                    self.brick_edge
                ),
            ));
        }
        if self.name.len() > MAX_NAME {
            return Err(Error::new(
                ErrorKind::LimitExceeded,
                format!("a name of {} bytes: at most {MAX_NAME}", self.name.len()),
            ));
        }
        // Here and not when it is written, which is after all the work.
        if self.history.len() > MAX_HISTORY {
            return Err(Error::new(
                ErrorKind::LimitExceeded,
                format!(
                    "a history of {} bytes: at most {MAX_HISTORY}",
                    self.history.len()
                ),
            ));
        }
        self.grid.index_to_world.validate()?;
        exact_bits_of(self.sample, self.background, "the background")?;
        Ok(())
    }

    /// The box of samples of a brick, cut to the domain.
    pub(crate) fn brick_box(&self, brick: [u32; 3]) -> Box3 {
        self.node_box(brick, 1)
    }

    /// The box of samples of a cube of `edge` bricks per axis from `brick`, cut to the domain.
    pub(crate) fn node_box(&self, brick: [u32; 3], edge: u32) -> Box3 {
        let domain = self.grid.domain;
        let at = |a: usize, b: u64| {
            let offset = (b * u64::from(self.brick_edge)).min(u64::from(domain.size()[a]));
            (i64::from(domain.min[a]) + offset as i64) as i32
        };
        Box3::new(
            std::array::from_fn(|a| at(a, u64::from(brick[a]))),
            std::array::from_fn(|a| at(a, u64::from(brick[a]) + u64::from(edge))),
        )
    }

    /// Least page level whose page covers all bricks.
    pub(crate) fn root_level(&self) -> u8 {
        let longest = self.bricks().into_iter().max().unwrap_or(1);
        (1..super::layout::MAX_PAGE_LEVEL)
            .find(|&level| longest <= page_edge(level))
            .unwrap_or(super::layout::MAX_PAGE_LEVEL)
    }
}

/// Bricks per axis of a page of `level`; of a slot of a page of `level + 1`.
pub(crate) const fn page_edge(level: u8) -> u32 {
    1 << (super::layout::PAGE_LEVELS * level as u32)
}

/// What is known of a finished volume.
#[derive(Clone, Debug, PartialEq)]
pub struct VolumeInfo {
    /// All lattice points that carry a sample.
    pub domain: Box3,
    /// Type of the stored samples.
    pub sample: SampleType,
    /// What the samples mean.
    pub kind: Kind,
    /// Edge of the bricks.
    pub brick_edge: u32,
    /// Smallest and largest sample of the whole domain, and whether any is NaN.
    pub range: Range,
    /// Bricks that are stored.
    pub bricks_stored: u64,
    /// Bricks of the domain that lie in constant tiles.
    pub bricks_constant: u64,
    /// Bricks of the domain that hold the background only.
    pub bricks_background: u64,
    /// Constant tiles over all levels.
    pub tiles: u64,
    /// Node pages.
    pub pages: u64,
    /// Levels of node pages above the bricks, each three octree levels; 0 when all is background.
    pub page_levels: u8,
    /// Bytes of the samples of the domain as a plain array (a bit counts as one eighth).
    pub bytes_raw: u64,
    /// Bytes of the stored bricks.
    pub bytes_stored: u64,
    /// Bytes of records that the newest generation reaches.
    pub bytes_live: u64,
    /// Bytes of records that it does not reach.
    pub bytes_dead: u64,
    /// Bytes of the whole file.
    pub bytes_file: u64,
    /// `bytes_raw / bytes_file`.
    pub compression: f64,
    /// Commits so far.
    pub generation: u64,
    /// Whether the file was made by [`compact`](super::compact) and not changed since.
    pub sealed: bool,
    /// Slabs of bricks that an import has committed which is not finished; the rest of the volume
    /// reads as background.
    pub unfinished_slabs: Option<u32>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn specs_say_what_is_wrong() {
        let good = VolumeSpec::new(Grid::new(Box3::from_size([10, 20, 30])), SampleType::U8);
        assert!(good.validate().is_ok());
        assert_eq!((good.bricks(), good.root_level()), ([1, 1, 1], 1));
        let bad = |change: &dyn Fn(&mut VolumeSpec)| {
            let mut spec = good.clone();
            change(&mut spec);
            spec.validate().expect_err("refused").to_string()
        };
        assert!(bad(&|s| s.background = 256.0).contains("256"));
        assert!(bad(&|s| s.background = f64::NAN).contains("NaN"));
        assert!(bad(&|s| s.brick_edge = 12).contains("12"));
        assert!(bad(&|s| s.name = "x".repeat(256)).contains("255"));
        assert!(bad(&|s| s.history = "x".repeat(1 << 20)).contains("1048560"));
        assert!(bad(&|s| s.grid.domain.max[1] = 0).contains("no samples"));
        assert!(bad(&|s| s.grid.domain.max[1] = i32::MAX).contains("134217728"));
        assert!(bad(&|s| s.grid.index_to_world.rows[0][0] = 0.0).contains("flattens"));
    }

    #[test]
    fn boxes_at_the_border_of_the_integers() {
        let max = i32::MAX;
        let domain = Box3::new([max - 20, i32::MIN, -5], [max, i32::MIN + 17, 5]);
        let spec = VolumeSpec {
            brick_edge: 8,
            ..VolumeSpec::new(Grid::new(domain), SampleType::F32)
        };
        assert_eq!(spec.bricks(), [3, 3, 2]);
        assert_eq!(
            spec.brick_box([2, 2, 1]),
            Box3::new([max - 4, i32::MIN + 16, 3], [max, i32::MIN + 17, 5])
        );
        assert_eq!(spec.node_box([0; 3], 8), domain);
    }
}
