//! Parsers of command line values that clap does not have.

use std::ops::RangeInclusive;

/// How far a mesh is simplified: `10%` of its triangles, or an error in the units of the mesh.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Simplify {
    Ratio(f64),
    Error(f64),
}

/// `10%` or `0.05`.
///
/// # Errors
/// Says what is allowed.
pub(crate) fn simplify(text: &str) -> Result<Simplify, String> {
    let bad = || {
        format!(
            "'{text}': give a share of the triangles, as 10%, or the largest error in the units of the mesh, as 0.05"
        )
    };
    let number = |text: &str| text.trim().parse::<f64>().map_err(|_| bad());
    match text.trim().strip_suffix('%') {
        Some(percent) => {
            let percent = number(percent)?;
            let good = percent > 0.0 && percent < 100.0;
            good.then_some(Simplify::Ratio(percent / 100.0))
                .ok_or_else(bad)
        }
        None => {
            let error = number(text)?;
            let good = error > 0.0 && error.is_finite();
            good.then_some(Simplify::Error(error)).ok_or_else(bad)
        }
    }
}

/// `64MiB`, `1.5 GiB`, `4096`, `200MB` in bytes.
///
/// # Errors
/// Says how a size is written.
pub(crate) fn size(text: &str) -> Result<u64, String> {
    let bad =
        || format!("'{text}' is not a size: write a number and KiB, MiB or GiB, as in 256MiB");
    let text_ = text.trim();
    let digits = text_
        .find(|c: char| !c.is_ascii_digit() && c != '.')
        .unwrap_or(text_.len());
    let (number, unit) = text_.split_at(digits);
    let factor: u64 = match unit.trim().to_ascii_lowercase().as_str() {
        "" | "b" => 1,
        "k" | "kib" => 1 << 10,
        "m" | "mib" => 1 << 20,
        "g" | "gib" => 1 << 30,
        "t" | "tib" => 1 << 40,
        "kb" => 1_000,
        "mb" => 1_000_000,
        "gb" => 1_000_000_000,
        _ => return Err(bad()),
    };
    let bytes = match number.parse::<u64>() {
        Ok(whole) => whole.checked_mul(factor).ok_or_else(bad)?,
        Err(_) => {
            let value: f64 = number.parse().map_err(|_| bad())?;
            let bytes = value * factor as f64;
            if !(bytes.is_finite() && bytes < u64::MAX as f64) {
                return Err(bad());
            }
            bytes as u64
        }
    };
    if bytes == 0 { Err(bad()) } else { Ok(bytes) }
}

/// `all` as the largest number, `none` as 0, or a number of triangles.
///
/// # Errors
/// Says how it is written.
pub(crate) fn crossings(text: &str) -> Result<u64, String> {
    match (text, text.parse()) {
        ("all", _) => Ok(u64::MAX),
        ("none", _) => Ok(0),
        (_, Ok(n)) => Ok(n),
        _ => Err(format!(
            "'{text}': write all, none, or a number of triangles"
        )),
    }
}

/// `largest` as 1, or a number from 1.
///
/// # Errors
/// Says how it is written.
pub(crate) fn component(text: &str) -> Result<u64, String> {
    match (text, text.parse()) {
        ("largest", _) => Ok(1),
        (_, Ok(n)) if n > 0 => Ok(n),
        _ => Err(format!(
            "'{text}': write largest, or a number from 1, where 1 is the largest"
        )),
    }
}

/// Segments of a label volume.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum LabelList {
    /// All but 0.
    All,
    /// These, in order, each once.
    These(Vec<u32>),
}

/// `all`, or `1,2,5`.
///
/// # Errors
/// Says how it is written.
pub(crate) fn labels(text: &str) -> Result<LabelList, String> {
    if text == "all" {
        return Ok(LabelList::All);
    }
    let number = |part: &str| {
        part.trim().parse().map_err(|_| {
            format!("'{text}': write all, or segment numbers with commas, as in 1,2,5")
        })
    };
    let mut list: Vec<u32> = text.split(',').map(number).collect::<Result<_, _>>()?;
    list.sort_unstable();
    list.dedup();
    Ok(LabelList::These(list))
}

/// `1,2,3` as three values of one kind.
///
/// # Errors
/// Says how it is written.
pub(crate) fn triple<T: std::str::FromStr>(text: &str) -> Result<[T; 3], String> {
    let bad = || format!("'{text}': write three numbers with commas, as in 10,20,30");
    let parts: Vec<T> = text
        .split(',')
        .map(|p| p.trim().parse().map_err(|_| bad()))
        .collect::<Result<_, _>>()?;
    parts.try_into().map_err(|_| bad())
}

/// `128,128,64` as sizes, none of them zero.
///
/// # Errors
/// Says how it is written.
pub(crate) fn dims(text: &str) -> Result<[u32; 3], String> {
    let dims: [u32; 3] = triple(text)?;
    if dims.contains(&0) || dims.iter().any(|&d| d > i32::MAX as u32) {
        return Err(format!(
            "'{text}': every size must be from 1 to {}",
            i32::MAX
        ));
    }
    Ok(dims)
}

/// `dx,dy,dz`, finite and not zero.
///
/// # Errors
/// Says how it is written.
pub(crate) fn spacing(text: &str) -> Result<[f64; 3], String> {
    let spacing: [f64; 3] = triple(text)?;
    if spacing.iter().any(|s| !s.is_finite() || *s == 0.0) {
        return Err(format!(
            "'{text}': every spacing must be finite and not zero"
        ));
    }
    Ok(spacing)
}

/// A finite number.
///
/// # Errors
/// Says what is wrong.
pub(crate) fn finite(text: &str) -> Result<f64, String> {
    match text.trim().parse::<f64>() {
        Ok(value) if value.is_finite() => Ok(value),
        _ => Err(format!("'{text}' is not a finite number")),
    }
}

/// A finite f32.
///
/// # Errors
/// Says what is wrong.
pub(crate) fn isovalue(text: &str) -> Result<f32, String> {
    let value = finite(text)? as f32;
    if value.is_finite() {
        Ok(value)
    } else {
        Err(format!("'{text}' is beyond 32-bit floating point"))
    }
}

/// `lo:hi` with lo < hi.
///
/// # Errors
/// Says how it is written.
pub(crate) fn window(text: &str) -> Result<(f64, f64), String> {
    let bad = || format!("'{text}' is not a window: write lo:hi with lo < hi, as in -200:300");
    let (low, high) = text.split_once(':').ok_or_else(bad)?;
    let (low, high) = (finite(low)?, finite(high)?);
    if low < high {
        Ok((low, high))
    } else {
        Err(bad())
    }
}

/// `width,level` with a width above 0.
///
/// # Errors
/// Says how it is written.
pub(crate) fn window_level(text: &str) -> Result<[f64; 2], String> {
    let bad = || {
        format!("'{text}': write the width of the window, above 0, and its middle, as in 400,40")
    };
    let (width, level) = text.split_once(',').ok_or_else(bad)?;
    let both = [finite(width)?, finite(level)?];
    if both[0] > 0.0 { Ok(both) } else { Err(bad()) }
}

/// `1.5,2,-3`, all finite.
///
/// # Errors
/// Says how it is written.
pub(crate) fn point(text: &str) -> Result<[f64; 3], String> {
    let point: [f64; 3] = triple(text)?;
    if point.iter().all(|v| v.is_finite()) {
        Ok(point)
    } else {
        Err(format!("'{text}': every number must be finite"))
    }
}

/// `x0:x1,y0:y1,z0:z1` in world units.
///
/// # Errors
/// Says how it is written.
pub(crate) fn world_region(text: &str) -> Result<[[f64; 2]; 3], String> {
    let bad = || format!("'{text}' is not a region: write x0:x1,y0:y1,z0:z1 in world units");
    let parts: Vec<[f64; 2]> = text
        .split(',')
        .map(|part| window(part).map(|(low, high)| [low, high]))
        .collect::<Result<_, _>>()
        .map_err(|_| bad())?;
    parts.try_into().map_err(|_| bad())
}

/// `azimuth,elevation` in degrees.
///
/// # Errors
/// Says how it is written.
pub(crate) fn view(text: &str) -> Result<[f64; 2], String> {
    let bad = || format!("'{text}' is not a view: write azimuth,elevation in degrees, as in 30,25");
    let (azimuth, elevation) = text.split_once(',').ok_or_else(bad)?;
    let view = [finite(azimuth)?, finite(elevation)?];
    if view[1].abs() > 90.0 {
        Err(bad())
    } else {
        Ok(view)
    }
}

/// `WIDTHxHEIGHT` in pixels.
///
/// # Errors
/// Says how it is written.
pub(crate) fn pixels(text: &str) -> Result<[u32; 2], String> {
    const SIDE: RangeInclusive<u32> = 16..=8192;
    let bad =
        || format!("'{text}' is not a picture size: write WIDTHxHEIGHT, each from 16 to 8192");
    let (w, h) = text.split_once('x').ok_or_else(bad)?;
    let side = |t: &str| {
        t.trim()
            .parse()
            .ok()
            .filter(|v| SIDE.contains(v))
            .ok_or_else(bad)
    };
    Ok([side(w)?, side(h)?])
}

/// `#e8d9be` or `e8d9be`.
///
/// # Errors
/// Says how it is written.
pub(crate) fn colour(text: &str) -> Result<[u8; 3], String> {
    let bad = || format!("'{text}' is not a colour: write six hexadecimal digits, as in e8d9be");
    let digits = text.strip_prefix('#').unwrap_or(text);
    if digits.len() != 6 || !digits.bytes().all(|b| b.is_ascii_hexdigit()) {
        return Err(bad());
    }
    let value = u32::from_str_radix(digits, 16).map_err(|_| bad())?;
    Ok([(value >> 16) as u8, (value >> 8) as u8, value as u8])
}

/// A part and the count of parts: `3/7`.
pub(crate) fn part(text: &str) -> Result<[u32; 2], String> {
    let bad = || format!("'{text}': a part is its number and their count, as 3/7");
    let (number, of) = text.split_once('/').ok_or_else(bad)?;
    let number: u32 = number.trim().parse().map_err(|_| bad())?;
    let of: u32 = of.trim().parse().map_err(|_| bad())?;
    if (1..=of).contains(&number) && of <= 1 << 20 {
        Ok([number, of])
    } else {
        Err(format!(
            "'{text}': the number goes from 1 to the count, which is at most 2^20"
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn components_and_labels() {
        assert_eq!(component("largest"), Ok(1));
        assert_eq!(component("3"), Ok(3));
        assert_eq!(labels("all"), Ok(LabelList::All));
        assert_eq!(labels("5, 1,5"), Ok(LabelList::These(vec![1, 5])));
        for bad in ["", "0", "-1", "1.5", "smallest", "Largest"] {
            assert!(component(bad).is_err(), "{bad}");
        }
        for bad in ["", "1,", "-1", "4294967296", "ALL", "1;2"] {
            assert!(labels(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn sizes() {
        assert_eq!(size("256MiB"), Ok(256 << 20));
        assert_eq!(size("1.5 GiB"), Ok(3 << 29));
        assert_eq!(size("4096"), Ok(4096));
        assert_eq!(size("2kb"), Ok(2000));
        assert_eq!(size("1g"), Ok(1 << 30));
        for bad in [
            "",
            "MiB",
            "0",
            "-1",
            "1XB",
            "1.2.3MiB",
            "99999999999999999999GiB",
            "inf",
            "1e9",
        ] {
            assert!(size(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn triples_and_regions() {
        assert_eq!(triple::<i32>("1,-2, 3"), Ok([1, -2, 3]));
        assert!(triple::<i32>("1,2").is_err());
        assert!(triple::<i32>("1,2,3,4").is_err());
        assert!(triple::<i32>("1,2,x").is_err());
        assert_eq!(dims("3,4,5"), Ok([3, 4, 5]));
        assert!(dims("3,0,5").is_err());
        assert!(dims("3,-1,5").is_err());
        assert!(dims("3,4294967295,5").is_err());
        assert!(spacing("1,nan,1").is_err());
        assert!(spacing("1,0,1").is_err());
        assert_eq!(spacing("1,-1,0.5"), Ok([1.0, -1.0, 0.5]));
        assert_eq!(
            world_region("0:1,-2:2,3:4.5"),
            Ok([[0.0, 1.0], [-2.0, 2.0], [3.0, 4.5]])
        );
        assert!(world_region("1:0,0:1,0:1").is_err());
        assert!(world_region("0:1,0:1").is_err());
    }

    #[test]
    fn pictures() {
        assert_eq!(window("-200:300"), Ok((-200.0, 300.0)));
        assert!(window("3:3").is_err() && window("3").is_err() && window("nan:3").is_err());
        assert_eq!(view("30,-25.5"), Ok([30.0, -25.5]));
        assert!(view("30,91").is_err() && view("30").is_err());
        assert_eq!(pixels("800x600"), Ok([800, 600]));
        for bad in ["800", "0x5", "8x8", "9999x600", "-80x60"] {
            assert!(pixels(bad).is_err(), "{bad}");
        }
        assert_eq!(colour("#0a10ff"), Ok([10, 16, 255]));
        assert!(colour("red").is_err() && colour("+1a2b3").is_err());
        assert!(isovalue("1e39").is_err() && isovalue("nan").is_err());
        assert_eq!(isovalue("-500"), Ok(-500.0));
    }
}
