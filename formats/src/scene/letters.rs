//! Capital letters, digits and some signs as strokes of a round pen.

/// Strokes on a grid 4 wide and 6 high: points as pairs of digits, strokes with blanks between.
const GLYPHS: [(char, &str); 42] = [
    ('A', "002640 1333"),
    ('B', "00063645443303 3342413000"),
    ('C', "4536160501103041"),
    ('D', "00062644422000"),
    ('E', "46060040 0333"),
    ('F', "460600 0333"),
    ('G', "45361605011030414323"),
    ('H', "0006 4046 0343"),
    ('I', "1030 1636 2026"),
    ('J', "3631201001"),
    ('K', "0006 460340"),
    ('L', "060040"),
    ('M', "0006234640"),
    ('N', "00064046"),
    ('O', "103041453616050110"),
    ('P', "00063645443303"),
    ('Q', "103041453616050110 2240"),
    ('R', "00063645443303 2340"),
    ('S', "453616050413334241301001"),
    ('T', "0646 2026"),
    ('U', "060110304146"),
    ('V', "062046"),
    ('W', "0610233046"),
    ('X', "0046 0640"),
    ('Y', "062346 2023"),
    ('Z', "06460040"),
    ('0', "103041453616050110 1135"),
    ('1', "052620 1030"),
    ('2', "05163645440040"),
    ('3', "064624344341301001"),
    ('4', "30360242"),
    ('5', "460603334241301001"),
    ('6', "453616050110304142331302"),
    ('7', "064610"),
    ('8', "133342413010010213 1304051636454433"),
    ('9', "011030414536160504133344"),
    ('-', "1333"),
    ('+', "0343 2125"),
    ('/', "0046"),
    ('.', "20"),
    ('=', "0242 0444"),
    (' ', ""),
];

/// Width of a letter and the space behind it, in grid units.
const ADVANCE: f64 = 5.5;

/// Most letters of a text.
const MAX_LETTERS: usize = 10_000;

/// Strokes of `text`, centred at the origin, capitals `size` high.
///
/// # Errors
/// Names the letter that there is no stroke for.
pub(super) fn lines(text: &str, size: f64) -> Result<Vec<Vec<[f64; 2]>>, String> {
    if !(size.is_finite() && size > 0.0) {
        return Err(format!("'size' is {size}: give a number above 0"));
    }
    let count = text.chars().count();
    if count == 0 || count > MAX_LETTERS {
        return Err(format!(
            "'text' has {count} letters: give from 1 to {MAX_LETTERS}"
        ));
    }
    let unit = size / 6.0;
    let left = -0.5 * (ADVANCE * count as f64 - (ADVANCE - 4.0));
    let mut out = Vec::new();
    for (n, letter) in text.chars().enumerate() {
        let wanted = letter.to_ascii_uppercase();
        let Some((_, strokes)) = GLYPHS.iter().find(|(c, _)| *c == wanted) else {
            return Err(format!(
                "'text': there is no letter '{letter}': use A to Z, 0 to 9, blank and - + / . ="
            ));
        };
        let start = left + ADVANCE * n as f64;
        for stroke in strokes.split_whitespace() {
            let points = stroke.as_bytes().as_chunks::<2>().0.iter().map(|[x, y]| {
                [
                    unit * (start + f64::from(x - b'0')),
                    unit * (f64::from(y - b'0') - 3.0),
                ]
            });
            out.push(points.collect());
        }
    }
    Ok(out)
}
