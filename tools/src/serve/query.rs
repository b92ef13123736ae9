//! The part of an address behind the question mark, read strictly: a name that is not known or given
//! twice is a mistake that is better said than passed over.

use super::refusal::Refusal;
use crate::parse;
use brickmarch::{Box3, Grid};
use clap::ValueEnum;

/// Names and values, decoded.
pub(super) struct Query(Vec<(String, String)>);

impl Query {
    /// Reads `name=value&...`, where only `known` names may stand.
    pub(super) fn read(text: Option<&str>, known: &[&str]) -> Result<Query, Refusal> {
        let mut pairs: Vec<(String, String)> = Vec::new();
        for part in text.unwrap_or("").split('&').filter(|p| !p.is_empty()) {
            let (name, value) = part.split_once('=').unwrap_or((part, ""));
            let (name, value) = (decode(name)?, decode(value)?);
            if !known.contains(&name.as_str()) {
                return Err(Refusal::bad(format!(
                    "{}: there is no such parameter here; there are: {}",
                    quoted(&name),
                    known.join(", ")
                )));
            }
            if pairs.iter().any(|(n, _)| *n == name) {
                return Err(Refusal::bad(format!("{name} is given twice")));
            }
            pairs.push((name, value));
        }
        Ok(Query(pairs))
    }

    pub(super) fn text(&self, name: &str) -> Option<&str> {
        let pair = self.0.iter().find(|(n, _)| n == name);
        pair.map(|(_, value)| value.as_str())
    }

    /// The value of `name`, read by `read`.
    pub(super) fn get<T>(
        &self,
        name: &str,
        read: impl FnOnce(&str) -> Result<T, String>,
    ) -> Result<Option<T>, Refusal> {
        let value = self.text(name).map(read).transpose();
        value.map_err(|e| Refusal::bad(format!("{name}: {}", shorten(&e))))
    }

    /// The same where there must be one.
    pub(super) fn need<T>(
        &self,
        name: &str,
        read: impl FnOnce(&str) -> Result<T, String>,
    ) -> Result<T, Refusal> {
        self.get(name, read)?
            .ok_or_else(|| Refusal::bad(format!("{name} is missing")))
    }

    /// One of the words of `T`.
    pub(super) fn word<T: ValueEnum>(&self, name: &str) -> Result<Option<T>, Refusal> {
        self.get(name, |text| {
            T::from_str(text, false).map_err(|_| {
                let words = T::value_variants()
                    .iter()
                    .filter_map(|v| v.to_possible_value());
                let words: Vec<String> = words.map(|w| w.get_name().to_string()).collect();
                format!("write one of {}", words.join(", "))
            })
        })
    }

    /// The level of detail, 0 where none is asked for.
    pub(super) fn level(&self) -> Result<u8, Refusal> {
        Ok(self.get("level", number::<u8>)?.unwrap_or(0))
    }

    /// The box from `min` to `max`, which lies in the domain and is not empty.
    pub(super) fn region(&self, grid: &Grid) -> Result<Box3, Refusal> {
        let min = self.need("min", parse::triple::<i32>)?;
        let max = self.need("max", parse::triple::<i32>)?;
        let region = Box3 { min, max };
        if (0..3).any(|a| min[a] >= max[a]) {
            return Err(Refusal::bad(
                "the region is empty: max is the first index that is not in it, so each must be above min",
            ));
        }
        if !grid.domain.contains_box(&region) {
            return Err(Refusal::bad(format!(
                "the region {region} is not inside the domain {}",
                grid.domain
            )));
        }
        Ok(region)
    }
}

/// A whole number.
pub(super) fn number<T: std::str::FromStr>(text: &str) -> Result<T, String> {
    text.parse()
        .map_err(|_| format!("{} is not a whole number in its range", quoted(text)))
}

/// Undoes `%2F` and `+`.
///
/// # Errors
/// 400 where a `%` is not followed by two hexadecimal digits, or the text is no UTF-8.
pub(super) fn decode(text: &str) -> Result<String, Refusal> {
    let bad = || Refusal::bad("the address is not percent-encoded UTF-8");
    let mut bytes = text.bytes();
    let mut out = Vec::with_capacity(text.len());
    while let Some(byte) = bytes.next() {
        out.push(match byte {
            b'+' => b' ',
            b'%' => {
                let digit = |b: Option<u8>| char::from(b?).to_digit(16);
                let high = digit(bytes.next()).ok_or_else(bad)?;
                let low = digit(bytes.next()).ok_or_else(bad)?;
                (high * 16 + low) as u8
            }
            other => other,
        });
    }
    String::from_utf8(out).map_err(|_| bad())
}

/// Text of a stranger, short enough to be shown to one.
pub(super) fn quoted(text: &str) -> String {
    format!("'{}'", shorten(text))
}

fn shorten(text: &str) -> String {
    let mut short: String = text.chars().take(120).filter(|c| !c.is_control()).collect();
    if text.chars().nth(120).is_some() {
        short.push_str("...");
    }
    short
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn queries_are_read_strictly() {
        let known = ["min", "max", "level", "window"];
        let read = |text: &str| Query::read(Some(text), &known);
        let good = read("min=1,-2,%33&max=4%2C5+,6&level=2").expect("good");
        assert_eq!(
            good.need("min", parse::triple::<i32>).expect("three"),
            [1, -2, 3]
        );
        assert_eq!(good.text("max"), Some("4,5 ,6"));
        assert_eq!(good.level().expect("a number"), 2);
        for bad in ["x=1", "min=1&min=1", "min=%", "min=%zz", "min=%ff", "%00=1"] {
            assert!(read(bad).is_err(), "{bad}");
        }
        for level in ["-1", "256", "1.0", "NaN", "", "99999999999999999999"] {
            let query = read(&format!("level={level}")).expect("a query");
            assert_eq!(query.level().expect_err(level).status, 400);
        }
    }

    #[test]
    fn regions_lie_in_the_domain() {
        let grid = Grid::new(Box3::from_size([10, 20, 30]));
        let region = |min: &str, max: &str| {
            let text = format!("min={min}&max={max}");
            let query = Query::read(Some(&text), &["min", "max"]).expect("a query");
            query.region(&grid)
        };
        assert_eq!(region("0,0,0", "10,20,30").expect("all"), grid.domain);
        for (min, max) in [
            ("0,0,0", "11,20,30"),
            ("-1,0,0", "1,1,1"),
            ("5,5,5", "5,6,6"),
            ("5,5,5", "4,6,6"),
            ("-2147483648,0,0", "2147483647,1,1"),
            ("2147483648,0,0", "1,1,1"),
            ("0,0", "1,1,1"),
            ("nan,0,0", "1,1,1"),
        ] {
            assert_eq!(region(min, max).expect_err(min).status, 400);
        }
    }
}
