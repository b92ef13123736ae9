//! Isolines drawn over a picture.

use super::Sheet;
use crate::picture::Picture;
use brickmarch::iso::Isolines;
use brickmarch::{Budget, Result};

/// Colours of the isovalues in their order, told apart also by who sees few colours (Okabe and Ito 2008, "Color
/// Universal Design"): orange, sky blue, bluish green, yellow, vermilion, reddish purple.
const COLOURS: [[u8; 3]; 6] = [
    [230, 159, 0],
    [86, 180, 233],
    [0, 158, 115],
    [240, 228, 66],
    [213, 94, 0],
    [204, 121, 167],
];

/// The lines of one isovalue, and how they are drawn.
pub(crate) struct Contour {
    pub iso: f32,
    pub colour: [u8; 3],
    pub lines: Isolines,
}

impl Contour {
    /// The lines of the isovalue that was given as the `n`-th.
    pub(crate) fn new(n: usize, iso: f32, colour: Option<[u8; 3]>, lines: Isolines) -> Contour {
        Contour {
            iso,
            colour: colour.unwrap_or(COLOURS[n % COLOURS.len()]),
            lines,
        }
    }

    /// Number of lines that are closed.
    pub(crate) fn closed(&self) -> usize {
        self.lines.iter().filter(|l| l.closed).count()
    }

    /// Length of all lines in the world.
    pub(crate) fn length(&self, sheet: &Sheet) -> f64 {
        let mut sum = 0.0;
        self.each_segment(sheet, |a, b| sum += (a[0] - b[0]).hypot(a[1] - b[1]));
        sum * sheet.unit
    }

    fn each_segment(&self, sheet: &Sheet, mut take: impl FnMut([f64; 2], [f64; 2])) {
        for line in self.lines.iter() {
            let last = line.points.len() - 1;
            let mut before = sheet.on_paper(line.points[if line.closed { last } else { 0 }]);
            for &point in &line.points[usize::from(!line.closed)..] {
                let point = sheet.on_paper(point);
                take(before, point);
                before = point;
            }
        }
    }
}

/// `#rrggbb`.
pub(crate) fn hex([r, g, b]: [u8; 3]) -> String {
    format!("#{r:02x}{g:02x}{b:02x}")
}

/// Draws lines of `width` pixels, with smooth edges, each isovalue over those before it; the picture gets three
/// channels.
///
/// # Errors
/// `BudgetExceeded`, `Cancelled`.
///
/// # Memory
/// 4 bytes a pixel at most.
pub(crate) fn draw(
    picture: &mut Picture,
    sheet: &Sheet,
    contours: &[Contour],
    width: f64,
    budget: &Budget,
) -> Result<()> {
    let count = picture.width as usize * picture.height as usize;
    let _permit = budget.take(count as u64 * 4, "the lines of the picture")?;
    in_colour(picture);
    for contour in contours {
        budget.check_cancelled()?;
        // What a line covers of each pixel: where two segments meet the larger, not both.
        let mut covered = vec![0u8; count];
        contour.each_segment(sheet, |a, b| {
            cover(&mut covered, [picture.width, picture.height], [a, b], width);
        });
        for (pixel, &part) in picture.bytes.chunks_exact_mut(3).zip(&covered) {
            if part > 0 {
                for (byte, colour) in pixel.iter_mut().zip(contour.colour) {
                    let (old, new, part) = (u32::from(*byte), u32::from(colour), u32::from(part));
                    *byte = ((old * (255 - part) + new * part + 127) / 255) as u8;
                }
            }
        }
    }
    Ok(())
}

/// Three channels instead of one.
pub(crate) fn in_colour(picture: &mut Picture) {
    if picture.channels == 1 {
        picture.bytes = picture.bytes.iter().flat_map(|&b| [b; 3]).collect();
        picture.channels = 3;
    }
}

/// Marks what a segment covers of each pixel, from 0 to 255.
fn cover(covered: &mut [u8], size: [u32; 2], [a, b]: [[f64; 2]; 2], width: f64) {
    let reach = 0.5 * width + 1.0;
    let span = |n: usize| {
        let low = (a[n].min(b[n]) - reach).floor().max(0.0) as usize;
        let high = (a[n].max(b[n]) + reach).ceil().max(0.0) as usize;
        low..high.min(size[n] as usize)
    };
    let along = [b[0] - a[0], b[1] - a[1]];
    let length2 = along[0] * along[0] + along[1] * along[1];
    for y in span(1) {
        for x in span(0) {
            let to = [x as f64 + 0.5 - a[0], y as f64 + 0.5 - a[1]];
            let t = match length2 {
                0.0 => 0.0,
                _ => ((to[0] * along[0] + to[1] * along[1]) / length2).clamp(0.0, 1.0),
            };
            let away = (to[0] - t * along[0]).hypot(to[1] - t * along[1]);
            let part = (0.5 * width + 0.5 - away).clamp(0.0, 1.0).min(width);
            let at = &mut covered[x + y * size[0] as usize];
            *at = (*at).max((part * 255.0 + 0.5) as u8);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_covers_its_width() {
        let mut covered = vec![0u8; 40 * 20];
        cover(&mut covered, [40, 20], [[5.0, 10.0], [35.0, 10.0]], 2.0);
        let column: Vec<u8> = (0..20).map(|y| covered[20 + 40 * y]).collect();
        assert_eq!(column.iter().map(|&v| u32::from(v)).sum::<u32>(), 2 * 255);
        assert_eq!((column[9], column[10]), (255, 255));
        // Slanted: the area is that of the line.
        let mut covered = vec![0u8; 100 * 100];
        cover(&mut covered, [100, 100], [[20.0, 20.0], [80.0, 65.0]], 3.0);
        let area = covered.iter().map(|&v| f64::from(v)).sum::<f64>() / 255.0;
        assert!((area - (75.0 * 3.0 + 7.07)).abs() < 3.0, "{area}");
    }
}
