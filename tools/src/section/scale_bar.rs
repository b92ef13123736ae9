//! A bar of a round length in the units of the world.

use crate::picture::Picture;
use brickmarch::{Error, Result, Units};

/// Narrowest picture that has room for a bar.
const WIDTH_MIN: u32 = 48;
/// Part of the width that the bar takes at most.
const PART: f64 = 0.3;
/// Columns and rows of a glyph, and the column between two.
const GLYPH: [usize; 2] = [5, 7];

/// Where a bar is in a picture.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct ScaleBar {
    /// Length in the world.
    pub length: f64,
    /// "20 mm".
    pub text: String,
    /// Pixels of a dot of its letters.
    dot: usize,
    /// Left and lower end of the bar, in pixels.
    at: [f64; 2],
    /// Width and height.
    pub size: [f64; 2],
}

impl ScaleBar {
    /// A bar for a picture whose pixels are `unit` long.
    ///
    /// # Errors
    /// When the picture is too narrow.
    pub(crate) fn new([w, h]: [u32; 2], unit: f64, units: Units) -> Result<ScaleBar> {
        if w < WIDTH_MIN || h < WIDTH_MIN / 2 {
            return Err(Error::bad_input(format!(
                "a picture of {w} x {h} pixels has no room for a scale bar: give a larger --scale"
            )));
        }
        let length = round_below(unit * f64::from(w) * PART);
        let name = match units {
            Units::Unknown => String::new(),
            known => format!(" {}", known.name()),
        };
        let number = match length {
            v if (1e-3..1e5).contains(&v) => format!("{}", (v * 1e6).round() / 1e6),
            v => format!("{v:e}"),
        };
        let least = w.min(h) as usize;
        let margin = (least as f64 / 24.0).max(4.0);
        let height = (least as f64 / 100.0).max(2.0).round();
        Ok(ScaleBar {
            length,
            text: number + &name,
            dot: (least / 240).max(1),
            at: [margin, f64::from(h) - margin],
            size: [length / unit, height],
        })
    }

    /// Lower left corner, width and height of the dark ground: left, top, width, height.
    fn ground(&self) -> [f64; 4] {
        let pad = self.pad();
        let text = self.text.chars().count() * (GLYPH[0] + 1) * self.dot;
        let width = self.size[0].max(text as f64) + 2.0 * pad;
        let height = self.size[1] + (GLYPH[1] * self.dot) as f64 + 3.0 * pad;
        [self.at[0] - pad, self.at[1] + pad - height, width, height]
    }

    fn pad(&self) -> f64 {
        3.0 * self.dot as f64
    }

    /// Left end and top of the letters.
    fn text_at(&self) -> [f64; 2] {
        let pad = self.pad();
        let height = (GLYPH[1] * self.dot) as f64;
        [self.at[0], self.at[1] - self.size[1] - pad - height]
    }

    /// Draws it; the picture has three channels.
    pub(crate) fn draw(&self, picture: &mut Picture) {
        let [left, top, width, height] = self.ground();
        fill(picture, [left, top, width, height], |old| old / 2);
        let [x, y] = self.at;
        let [w, h] = self.size;
        fill(picture, [x, y - h, w, h], |_| 255);
        let [x, y] = self.text_at();
        let dot = self.dot as f64;
        for (n, letter) in self.text.chars().enumerate() {
            for (row, bits) in glyph(letter).into_iter().enumerate() {
                for column in (0..GLYPH[0]).filter(|c| bits >> (GLYPH[0] - 1 - c) & 1 == 1) {
                    let at = [
                        x + dot * (n * (GLYPH[0] + 1) + column) as f64,
                        y + dot * row as f64,
                    ];
                    fill(picture, [at[0], at[1], dot, dot], |_| 255);
                }
            }
        }
    }

    /// The same for an SVG file.
    pub(crate) fn svg(&self) -> String {
        let [left, top, width, height] = self.ground();
        let [x, y] = self.at;
        let [w, h] = self.size;
        let size = (GLYPH[1] * self.dot) as f64;
        let base = self.text_at()[1] + size;
        format!(
            "<g id=\"scale-bar\" fill=\"#fff\">\
             <rect x=\"{left:.2}\" y=\"{top:.2}\" width=\"{width:.2}\" height=\"{height:.2}\" fill=\"#000\" fill-opacity=\"0.5\"/>\
             <rect x=\"{x:.2}\" y=\"{:.2}\" width=\"{w:.3}\" height=\"{h:.2}\"/>\
             <text x=\"{x:.2}\" y=\"{base:.2}\" font-family=\"sans-serif\" font-size=\"{:.1}\">{}</text></g>\n",
            y - h,
            1.3 * size,
            self.text
        )
    }
}

/// The largest of 1, 2 and 5 times a power of ten that is not above `most`.
fn round_below(most: f64) -> f64 {
    let power = most.log10().floor() as i32;
    // A negative power of ten is the nearest double as a quotient, not as a product.
    let scaled = |digit: f64, power: i32| match power {
        0.. => digit * 10f64.powi(power),
        _ => digit / 10f64.powi(-power),
    };
    let all = [(5.0, power), (2.0, power), (1.0, power), (5.0, power - 1)];
    let lengths = all.map(|(digit, power)| scaled(digit, power));
    let fits = lengths.into_iter().find(|&l| l <= most);
    fits.unwrap_or(most)
}

/// Changes the pixels whose centres lie in a rectangle.
fn fill(picture: &mut Picture, [x, y, w, h]: [f64; 4], change: impl Fn(u8) -> u8) {
    let span = |from: f64, length: f64, most: u32| {
        let end = |v: f64| (v - 0.5).ceil().clamp(0.0, f64::from(most)) as usize;
        end(from)..end(from + length)
    };
    let width = picture.width as usize;
    for row in span(y, h, picture.height) {
        for column in span(x, w, picture.width) {
            let at = 3 * (row * width + column);
            for byte in &mut picture.bytes[at..at + 3] {
                *byte = change(*byte);
            }
        }
    }
}

/// The letters that lengths need, rows from the top, five bits each.
fn glyph(letter: char) -> [u8; 7] {
    match letter {
        '0' => [0x0e, 0x11, 0x11, 0x11, 0x11, 0x11, 0x0e],
        '1' => [0x04, 0x0c, 0x04, 0x04, 0x04, 0x04, 0x0e],
        '2' => [0x0e, 0x11, 0x01, 0x06, 0x08, 0x10, 0x1f],
        '5' => [0x1f, 0x10, 0x1e, 0x01, 0x01, 0x11, 0x0e],
        '3' => [0x0e, 0x11, 0x01, 0x06, 0x01, 0x11, 0x0e],
        '4' => [0x02, 0x06, 0x0a, 0x12, 0x1f, 0x02, 0x02],
        '6' => [0x06, 0x08, 0x10, 0x1e, 0x11, 0x11, 0x0e],
        '7' => [0x1f, 0x01, 0x02, 0x04, 0x04, 0x08, 0x08],
        '8' => [0x0e, 0x11, 0x11, 0x0e, 0x11, 0x11, 0x0e],
        '9' => [0x0e, 0x11, 0x11, 0x0f, 0x01, 0x02, 0x0c],
        '.' => [0x00, 0x00, 0x00, 0x00, 0x00, 0x0c, 0x0c],
        '-' => [0x00, 0x00, 0x00, 0x0e, 0x00, 0x00, 0x00],
        'e' => [0x00, 0x00, 0x0e, 0x11, 0x1f, 0x10, 0x0e],
        'm' => [0x00, 0x00, 0x1a, 0x15, 0x15, 0x15, 0x15],
        'n' => [0x00, 0x00, 0x16, 0x19, 0x11, 0x11, 0x11],
        'u' => [0x00, 0x00, 0x11, 0x11, 0x11, 0x13, 0x0d],
        _ => [0; 7],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_are_round_and_as_long_as_they_say() {
        for (most, length) in [
            (99.0, 50.0),
            (0.21, 0.2),
            (1.0, 1.0),
            (7e-7, 5e-7),
            (4.9, 2.0),
        ] {
            assert_eq!(round_below(most), length);
        }
        for (width, unit) in [(400, 0.8), (3000, 1e-7), (64, 12.5), (51, 3e6)] {
            let bar = ScaleBar::new([width, 300], unit, Units::Millimetre).expect("room");
            assert!((bar.size[0] * unit / bar.length - 1.0).abs() < 1e-12);
            let part = bar.size[0] / f64::from(width);
            assert!((0.12..=0.3001).contains(&part), "{part}");
            let number: f64 = bar
                .text
                .split(' ')
                .next()
                .expect("a number")
                .parse()
                .expect("one");
            assert!((number / bar.length - 1.0).abs() < 1e-9, "{}", bar.text);
        }
        assert!(ScaleBar::new([40, 300], 1.0, Units::Unknown).is_err());
        let plain = ScaleBar::new([200, 300], 1.0, Units::Unknown).expect("room");
        assert_eq!(plain.text, "50");
    }

    #[test]
    fn the_bar_is_drawn_as_long_as_it_is() {
        let mut picture = Picture::rgb(400, 300);
        let bar = ScaleBar::new([400, 300], 0.5, Units::Micrometre).expect("room");
        assert_eq!(bar.text, "50 um");
        bar.draw(&mut picture);
        let row = (300.0 - 300.0 / 24.0 - 1.0) as usize * 400 * 3;
        let white = picture.bytes[row..row + 1200].iter().filter(|&&b| b == 255);
        assert_eq!(white.count(), 3 * 100);
    }
}
