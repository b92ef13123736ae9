//! Where the samples of an NRRD file lie in the world.

use crate::limits::{bad, unsupported};
use crate::nrrd::{Axes, Header};
use crate::text::shorten;
use brickmarch::{Affine, Result, Units};

/// Index to world, units, and notes. `space directions` and `space origin` where a space is given;
/// otherwise `spacings`, `axis mins` and `axis maxs`, one world axis for each index axis.
pub(crate) fn geometry(header: &Header, axes: &Axes) -> Result<(Affine, Units, Vec<String>)> {
    let mut notes = Vec::new();
    let space = header.get("space").map(str::to_lowercase);
    let dimension = match (&space, header.get("space dimension")) {
        (Some(name), _) if name.contains("time") || name.len() == 4 && !name.contains('-') => 4,
        (Some(_), _) => 3,
        (None, Some(text)) => text
            .parse()
            .map_err(|_| header.wrong("space dimension", "a number"))?,
        (None, None) => 0,
    };
    if dimension != 0 && dimension != 3 {
        return Err(unsupported(
            &header.path,
            format!("a world of {dimension} dimensions; a volume lies in three"),
        ));
    }
    let units = units(header, axes, space.as_deref(), &mut notes)?;
    let map = if let Some(text) = header.get("space directions") {
        let columns = directions(header, axes, text)?;
        let origin = match header.get("space origin") {
            Some(text) => {
                vector(text)
                    .filter(|(_, rest)| rest.is_empty())
                    .ok_or_else(|| header.wrong("space origin", "(x,y,z)"))?
                    .0
            }
            None => [0.0; 3],
        };
        Affine::from_columns(columns, origin)
    } else {
        along_axes(header, axes)?
    };
    map.validate()
        .map_err(|e| bad(&header.path, e.to_string()))?;
    Ok((map, units, notes))
}

/// World steps of the three axes that are kept.
fn directions(header: &Header, axes: &Axes, text: &str) -> Result<[[f64; 3]; 3]> {
    let wrong = || {
        let want = format!(
            "{} vectors (x,y,z), or none for an axis without place",
            axes.all
        );
        header.wrong("space directions", &want)
    };
    let mut all = Vec::new();
    let mut rest = text.trim();
    while !rest.is_empty() {
        if let Some(after) = rest.strip_prefix("none") {
            all.push(None);
            rest = after.trim_start();
        } else {
            let (step, after) = vector(rest).ok_or_else(wrong)?;
            all.push(Some(step));
            rest = after;
        }
        if all.len() > axes.all {
            return Err(wrong());
        }
    }
    if all.len() != axes.all {
        return Err(wrong());
    }
    let mut columns = [[0.0; 3]; 3];
    for (column, &axis) in columns.iter_mut().zip(&axes.numbers) {
        *column = all[axis].ok_or_else(wrong)?;
    }
    Ok(columns)
}

/// `(x,y,z)` and what follows it.
fn vector(text: &str) -> Option<([f64; 3], &str)> {
    let (inner, rest) = text.trim_start().strip_prefix('(')?.split_once(')')?;
    let values: Option<Vec<f64>> = inner.split(',').map(|v| v.trim().parse().ok()).collect();
    Some((values?.try_into().ok()?, rest.trim_start()))
}

fn along_axes(header: &Header, axes: &Axes) -> Result<Affine> {
    let mins = per_axis(header, axes, "axis mins")?;
    let maxs = per_axis(header, axes, "axis maxs")?;
    let spacings = per_axis(header, axes, "spacings")?;
    let centers = header
        .get("centers")
        .or(header.get("centerings"))
        .unwrap_or_default();
    let centers: Vec<&str> = centers.split_whitespace().collect();
    let (mut spacing, mut origin) = ([1.0; 3], [0.0; 3]);
    for a in 0..3 {
        // A cell-centred axis starts at the border of its first cell, half a step below the sample.
        let cell = centers.get(axes.numbers[a]) == Some(&"cell");
        let steps = if cell {
            axes.sizes[a]
        } else {
            axes.sizes[a] - 1
        };
        let spread = match (mins[a], maxs[a]) {
            (Some(min), Some(max)) if steps > 0 && max != min => Some((max - min) / steps as f64),
            _ => None,
        };
        spacing[a] = spacings[a].or(spread).unwrap_or(1.0);
        if let Some(min) = mins[a] {
            origin[a] = if cell { min + 0.5 * spacing[a] } else { min };
        }
    }
    Ok(Affine::from_spacing(spacing, origin))
}

/// One number for each kept axis; `nan` is a number that is not known.
fn per_axis(header: &Header, axes: &Axes, field: &str) -> Result<[Option<f64>; 3]> {
    let Some(text) = header.get(field) else {
        return Ok([None; 3]);
    };
    let values: Vec<f64> = crate::text::numbers(text)
        .filter(|values: &Vec<f64>| values.len() == axes.all)
        .ok_or_else(|| header.wrong(field, &format!("{} numbers", axes.all)))?;
    Ok(axes
        .numbers
        .map(|axis| Some(values[axis]).filter(|v| !v.is_nan())))
}

/// The unit of the world: as the file says; millimetres in an anatomical space, where the tools that
/// write them mean it.
fn units(
    header: &Header,
    axes: &Axes,
    space: Option<&str>,
    notes: &mut Vec<String>,
) -> Result<Units> {
    let (field, count) = match header.get("space units") {
        Some(_) => ("space units", 3),
        None => ("units", axes.all),
    };
    let Some(text) = header.get(field) else {
        let anatomical = space.is_some_and(|s| !s.contains("scanner") && !s.starts_with("3d"));
        return Ok(if anatomical {
            Units::Millimetre
        } else {
            Units::Unknown
        });
    };
    // Quoted names with anything between them.
    let names: Vec<&str> = text.split('"').skip(1).step_by(2).collect();
    let kept: Option<Vec<&str>> = match (field, names.len() == count) {
        (_, false) => None,
        ("units", _) => Some(axes.numbers.iter().map(|&axis| names[axis]).collect()),
        _ => Some(names),
    };
    let unit = kept.and_then(|names| {
        let first = unit(names[0])?;
        names
            .iter()
            .all(|n| unit(n) == Some(first))
            .then_some(first)
    });
    if unit.is_none() {
        notes.push(format!(
            "the units {} are not known; kept without",
            shorten(text)
        ));
    }
    Ok(unit.unwrap_or(Units::Unknown))
}

fn unit(name: &str) -> Option<Units> {
    Some(match name.trim() {
        "mm" | "millimeter" | "millimetre" | "millimeters" => Units::Millimetre,
        "um" | "\u{b5}m" | "\u{3bc}m" | "micron" | "microns" | "micrometer" => Units::Micrometre,
        "nm" | "nanometer" => Units::Nanometre,
        "m" | "meter" | "metre" | "meters" => Units::Metre,
        "" => Units::Unknown,
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use crate::testing::open_bytes;
    use brickmarch::{Affine, Result, Units};

    fn place(fields: &str) -> Result<(Affine, Units)> {
        let text = format!(
            "NRRD0005\ntype: uint8\ndimension: 3\nsizes: 1 2 3\nencoding: raw\n{fields}\n\nabcdef"
        );
        open_bytes("a.nrrd", text.as_bytes()).map(|s| (s.grid.index_to_world, s.grid.units))
    }

    #[test]
    fn directions_come_through_exactly() {
        let (map, units) = place(
            "space: left-posterior-superior\nspace directions: (0.1, 0,0) (0,-0.3,1e-3)  (0,0.25,7)\n\
             space origin: (-12.5,3,0.1)",
        )
        .expect("opens");
        let columns = [[0.1, 0.0, 0.0], [0.0, -0.3, 1e-3], [0.0, 0.25, 7.0]];
        assert_eq!(map, Affine::from_columns(columns, [-12.5, 3.0, 0.1]));
        assert!(map.is_left_handed());
        assert_eq!(units, Units::Millimetre);
    }

    #[test]
    fn spacings_mins_and_maxs() {
        let (map, units) = place("spacings: 0.5 nan 2").expect("opens");
        assert_eq!(map, Affine::from_spacing([0.5, 1.0, 2.0], [0.0; 3]));
        assert_eq!(units, Units::Unknown);
        let (map, _) =
            place("axis mins: 1 2 3\naxis maxs: 2 4 6\ncenters: cell node cell").expect("opens");
        assert_eq!(map, Affine::from_spacing([1.0, 2.0, 1.0], [1.5, 2.0, 3.5]));
    }

    #[test]
    fn units_as_the_file_says() {
        let with = |unit: &str| {
            let fields = format!(
                "space dimension: 3\nspace directions: (1,0,0) (0,1,0) (0,0,1)\nspace units: {unit}"
            );
            place(&fields).expect("opens").1
        };
        assert_eq!(with("\"um\" \"um\" \"um\""), Units::Micrometre);
        assert_eq!(with("\"mm\" \"um\" \"um\""), Units::Unknown);
        assert_eq!(with("\"\" \"\" \"\""), Units::Unknown);
        assert_eq!(with("mm"), Units::Unknown);
        assert_eq!(
            place("units: \"nm\" \"nm\" \"nm\"").expect("opens").1,
            Units::Nanometre
        );
    }

    #[test]
    fn wrong_geometry_is_refused() {
        for fields in [
            "spacings: 0 1 1",
            "spacings: 1 1",
            "spacings: inf 1 1",
            "space: RAS\nspace directions: (1,0,0) (0,1,0)",
            "space: RAS\nspace directions: (1,0,0) (0,1,0) (0,0)",
            "space: RAS\nspace directions: (1,0,0) (0,1,0) none",
            "space: RAS\nspace directions: (1,0,0) (0,1,0) (1,1,0)",
            "space: RAS\nspace directions: (1,0,0) (0,1,0) (0,0,1)\nspace origin: (1,2)",
            "space: right-anterior-superior-time",
            "space dimension: 2",
        ] {
            assert!(place(fields).is_err(), "{fields}");
        }
    }
}
