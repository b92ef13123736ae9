//! Flat outlines with their true distance: polygons with holes, and strokes for letters.

use super::interval::Interval;
use super::oracle::Oracle;
use crate::error::{Error, ErrorKind, Result};

/// Most corners of one outline.
const MAX_CORNERS: usize = 1 << 20;

/// Closed outlines filled by the even-odd rule, or lines drawn with a round pen.
#[derive(Clone, PartialEq)]
pub struct Profile {
    segments: Vec<[[f64; 2]; 2]>,
    /// Half the width of the pen; nothing for a filled outline.
    pen: Option<f64>,
}

impl std::fmt::Debug for Profile {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let n = self.segments.len();
        match self.pen {
            None => write!(f, "Profile({n} edges)"),
            Some(pen) => write!(f, "Profile({n} lines, pen {})", 2.0 * pen),
        }
    }
}

impl Profile {
    /// The inside of closed `contours` by the even-odd rule: a contour in another one is a hole.
    ///
    /// # Errors
    /// When a contour has fewer than three corners, or a coordinate is not finite.
    pub fn filled(contours: &[Vec<[f64; 2]>]) -> Result<Profile> {
        let mut segments = Vec::new();
        for contour in contours {
            if contour.len() < 3 {
                return Err(Error::bad_input(format!(
                    "outline: a contour of {} corners: give at least three",
                    contour.len()
                )));
            }
            let next = contour.iter().cycle().skip(1);
            segments.extend(contour.iter().zip(next).map(|(&a, &b)| [a, b]));
        }
        Profile::checked(segments, None)
    }

    /// Open `lines` drawn with a round pen of this `width`.
    ///
    /// # Errors
    /// When there is no line, or a number is not finite, or the width is not above zero.
    pub fn stroked(lines: &[Vec<[f64; 2]>], width: f64) -> Result<Profile> {
        super::build::positive("outline: pen width", &[width])?;
        let mut segments = Vec::new();
        for line in lines {
            match line.as_slice() {
                [] => {}
                [dot] => segments.push([*dot, *dot]),
                _ => segments.extend(line.windows(2).map(|w| [w[0], w[1]])),
            }
        }
        Profile::checked(segments, Some(0.5 * width))
    }

    fn checked(segments: Vec<[[f64; 2]; 2]>, pen: Option<f64>) -> Result<Profile> {
        if segments.is_empty() {
            return Err(Error::bad_input(
                "outline: it is empty: give at least one contour or line",
            ));
        }
        if segments.len() > MAX_CORNERS {
            return Err(Error::new(
                ErrorKind::LimitExceeded,
                format!(
                    "outline: {} edges: give at most {MAX_CORNERS}",
                    segments.len()
                ),
            ));
        }
        for segment in &segments {
            super::build::finite("outline: corner", segment.as_flattened())?;
        }
        Ok(Profile { segments, pen })
    }

    /// Smallest and largest coordinates.
    pub fn bounds(&self) -> [[f64; 2]; 2] {
        let grow = self.pen.unwrap_or(0.0);
        let mut out = [[f64::INFINITY; 2], [f64::NEG_INFINITY; 2]];
        for p in self.segments.as_flattened() {
            for a in 0..2 {
                out[0][a] = out[0][a].min(p[a] - grow);
                out[1][a] = out[1][a].max(p[a] + grow);
            }
        }
        out
    }

    fn value(&self, p: [f64; 2], near: &[[[f64; 2]; 2]], crossed: &[[[f64; 2]; 2]]) -> f64 {
        let square = near
            .iter()
            .map(|s| nearest(s, p).1)
            .fold(f64::INFINITY, f64::min);
        let distance = square.sqrt();
        match self.pen {
            Some(pen) => distance - pen,
            None if is_inside(crossed, p) => -distance,
            None => distance,
        }
    }
}

/// Nearest point of a segment and the square of its distance.
fn nearest(segment: &[[f64; 2]; 2], p: [f64; 2]) -> ([f64; 2], f64) {
    let [a, b] = *segment;
    let (ex, ey) = (b[0] - a[0], b[1] - a[1]);
    let (px, py) = (p[0] - a[0], p[1] - a[1]);
    let square = ex * ex + ey * ey;
    let t = if square > 0.0 {
        ((px * ex + py * ey) / square).clamp(0.0, 1.0)
    } else {
        0.0
    };
    let (dx, dy) = (px - t * ex, py - t * ey);
    ([p[0] - dx, p[1] - dy], dx * dx + dy * dy)
}

/// Even-odd: crossings of the ray towards +x, each edge half-open in y.
fn is_inside(segments: &[[[f64; 2]; 2]], p: [f64; 2]) -> bool {
    let mut inside = false;
    for [a, b] in segments {
        if (a[1] > p[1]) != (b[1] > p[1]) {
            // From the lower end, so that an edge gives the same answer in both directions.
            let (low, high) = if a[1] < b[1] { (a, b) } else { (b, a) };
            let x = low[0] + (p[1] - low[1]) * ((high[0] - low[0]) / (high[1] - low[1]));
            inside ^= p[0] < x;
        }
    }
    inside
}

/// Middle and half diagonal of the points.
fn circle(x: &[f64], y: &[f64]) -> ([f64; 2], f64) {
    let ends = |v: &[f64]| {
        v.iter()
            .fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], &v| {
                [a.min(v), b.max(v)]
            })
    };
    let ([x0, x1], [y0, y1]) = (ends(x), ends(y));
    let middle = [0.5 * (x0 + x1), 0.5 * (y0 + y1)];
    (middle, 0.5 * ((x1 - x0).powi(2) + (y1 - y0).powi(2)).sqrt())
}

impl Oracle for Profile {
    fn values(&self, [x, y, _]: [&[f64]; 3], out: &mut [f64]) -> Result<()> {
        let (middle, radius) = circle(x, y);
        if !(radius.is_finite() && middle.iter().all(|m| m.is_finite())) {
            for ((o, &x), &y) in out.iter_mut().zip(x).zip(y) {
                *o = if x.is_finite() && y.is_finite() {
                    self.value([x, y], &self.segments, &self.segments)
                } else {
                    f64::NAN
                };
            }
            return Ok(());
        }
        // Only segments that are nearest to some point of the circle, or beside it, matter.
        let distances: Vec<f64> = self
            .segments
            .iter()
            .map(|s| nearest(s, middle).1.sqrt())
            .collect();
        let least = distances.iter().copied().fold(f64::INFINITY, f64::min);
        let reach = (least + 2.0 * radius) * (1.0 + 1e-9) + 1e-300;
        let near: Vec<_> = self
            .segments
            .iter()
            .zip(&distances)
            .filter(|&(_, &d)| d <= reach)
            .map(|(s, _)| *s)
            .collect();
        let (y0, y1) = (
            y.iter().copied().fold(f64::INFINITY, f64::min),
            y.iter().copied().fold(f64::NEG_INFINITY, f64::max),
        );
        let crossed: Vec<_> = self
            .segments
            .iter()
            .filter(|[a, b]| a[1].min(b[1]) <= y1 && a[1].max(b[1]) >= y0)
            .copied()
            .collect();
        for ((o, &x), &y) in out.iter_mut().zip(x).zip(y) {
            *o = self.value([x, y], &near, &crossed);
        }
        Ok(())
    }

    fn range(&self, [x, y, _]: [Interval; 3]) -> Result<Interval> {
        let middle = [x.middle(), y.middle()];
        let radius = 0.5 * ((x.hi - x.lo).powi(2) + (y.hi - y.lo).powi(2)).sqrt();
        if x.nan || y.nan || !radius.is_finite() {
            return Ok(Interval::ANY);
        }
        // It changes by no more than the way that is gone.
        let value = self.value(middle, &self.segments, &self.segments);
        let reach = radius + 1e-12 * (radius + value.abs() + x.magnitude() + y.magnitude());
        Ok(Interval::new(value - reach, value + reach))
    }

    fn slopes(&self, [x, y, _]: [Interval; 3]) -> Result<[Interval; 3]> {
        let one = Interval::new(-1.0, 1.0);
        if x.lo != x.hi || y.lo != y.hi {
            return Ok([one, one, Interval::ZERO]);
        }
        let p = [x.lo, y.lo];
        let found = self
            .segments
            .iter()
            .map(|s| nearest(s, p))
            .min_by(|a, b| a.1.total_cmp(&b.1));
        let Some((foot, square)) = found else {
            return Ok([one, one, Interval::ZERO]);
        };
        let sign = if self.pen.is_none() && is_inside(&self.segments, p) {
            -1.0
        } else {
            1.0
        };
        let length = square.sqrt();
        if length == 0.0 {
            return Ok([one, one, Interval::ZERO]);
        }
        let slope = |a: usize| Interval::point(sign * (p[a] - foot[a]) / length);
        Ok([slope(0), slope(1), Interval::ZERO])
    }

    fn rounding(&self, [x, y, _]: [Interval; 3]) -> Result<f64> {
        let ends = self.segments.as_flattened().as_flattened();
        let largest = ends.iter().fold(0.0f64, |most, v| most.max(v.abs()));
        Ok(1e-12 * (x.magnitude() + y.magnitude() + largest))
    }
}
