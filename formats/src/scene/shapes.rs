//! The primitives by name.

use super::keys::Keys;
use super::leaves;
use super::letters;
use super::value::{Item, Value};
use brickmarch::Result;
use brickmarch::model::{Convention, Periodic, Primitive, Profile, Shape};

/// Every name of a shape.
pub(super) const NAMES: [&str; 22] = [
    "sphere",
    "quadratic-sphere",
    "ellipsoid",
    "box",
    "cylinder",
    "capsule",
    "cone",
    "torus",
    "half-space",
    "extrude",
    "revolve",
    "gyroid",
    "schwarz-p",
    "diamond",
    "neovius",
    "iwp",
    "lidinoid",
    "polynomial",
    "formula",
    "metaballs",
    "heights",
    "volume",
];

/// # Errors
/// Names line and key.
pub(super) fn primitive(keys: &Keys<'_>) -> Result<Shape> {
    let name = keys.choice("shape", &NAMES)?.unwrap_or_default();
    let made = match name {
        "sphere" => Primitive::Sphere {
            radius: keys.need_number("radius")?,
        },
        "quadratic-sphere" => Primitive::QuadraticSphere {
            radius: keys.need_number("radius")?,
        },
        "ellipsoid" => Primitive::Ellipsoid {
            radii: keys.need_vector("radii")?,
        },
        "box" => Primitive::Box {
            size: keys.need_vector("size")?,
            rounding: keys.number_or("rounding", 0.0)?,
        },
        "cylinder" => Primitive::Cylinder {
            radius: keys.need_number("radius")?,
            height: keys.need_number("height")?,
        },
        "capsule" => Primitive::Capsule {
            from: keys.need_vector("from")?,
            to: keys.need_vector("to")?,
            radius: keys.need_number("radius")?,
        },
        "cone" => Primitive::Cone {
            bottom: keys.need_number("bottom")?,
            top: keys.number_or("top", 0.0)?,
            height: keys.need_number("height")?,
        },
        "torus" => Primitive::Torus {
            major: keys.need_number("major")?,
            minor: keys.need_number("minor")?,
        },
        "half-space" => Primitive::HalfSpace {
            normal: keys.need_vector("normal")?,
            offset: keys.number_or("offset-along", 0.0)?,
        },
        "extrude" => Primitive::Extrude {
            profile: profile(keys)?,
            height: keys.need_number("height")?,
        },
        "revolve" => Primitive::Revolve {
            profile: profile(keys)?,
        },
        "polynomial" => Primitive::Polynomial {
            terms: terms(keys)?,
        },
        "formula" => {
            let value = keys.formula("value")?;
            Primitive::Formula {
                value,
                convention: convention(keys, "level")?,
            }
        }
        "metaballs" => metaballs(keys)?,
        "heights" => leaves::heights(keys)?,
        "volume" => leaves::volume(keys)?,
        name => match Periodic::ALL.into_iter().find(|p| p.name() == name) {
            Some(surface) => Primitive::Periodic {
                surface,
                period: keys.need_number("period")?,
                thickness: keys.number_or("thickness", 0.0)?,
            },
            None => return Err(keys.scope.error(keys.line, format!("no shape '{name}'"))),
        },
    };
    Ok(Shape::Primitive(made))
}

/// What values mean, by the keys `as` and `iso`.
pub(super) fn convention(keys: &Keys<'_>, default: &'static str) -> Result<Convention> {
    let name = keys.choice("as", &["distance", "level", "density"])?;
    Ok(match name.unwrap_or(default) {
        "distance" => Convention::Distance,
        "level" => Convention::Level,
        _ => Convention::Density {
            iso: keys.need_number("iso")?,
        },
    })
}

fn points(keys: &Keys<'_>, key: &str, items: &[Item]) -> Result<Vec<Vec<[f64; 2]>>> {
    items
        .iter()
        .map(|line| match &line.value {
            Value::List(points) => points
                .iter()
                .map(|p| keys.scope.numbers::<2>(key, p))
                .collect(),
            other => Err(keys.scope.error(
                line.line,
                format!(
                    "'{key}' holds {}: give lists of points, as in [[[0, 0], [1, 0], [0, 1]]]",
                    other.noun()
                ),
            )),
        })
        .collect()
}

/// `contours` (filled), `lines` with `pen`, or `text` with `pen` and `size`.
fn profile(keys: &Keys<'_>) -> Result<Profile> {
    let contours = keys.list("contours")?;
    let lines = keys.list("lines")?;
    let text = keys.text("text")?;
    let made = match (contours, lines, text) {
        (Some(contours), None, None) => Profile::filled(&points(keys, "contours", contours)?),
        (None, Some(lines), None) => {
            let pen = keys.need_number("pen")?;
            Profile::stroked(&points(keys, "lines", lines)?, pen)
        }
        (None, None, Some(text)) => {
            let pen = keys.need_number("pen")?;
            let size = keys.need_number("size")?;
            letters::lines(text, size)
                .map_err(|e| keys.scope.error(keys.line, e))
                .and_then(|lines| Profile::stroked(&lines, pen))
        }
        _ => {
            return Err(keys.scope.error(
                keys.line,
                "an outline is one of 'contours', 'lines' with 'pen', or 'text' with 'pen' and 'size': give one".into(),
            ));
        }
    };
    made.map_err(|e| {
        let text = e.to_string();
        if text.starts_with("outline") {
            keys.scope.error(keys.line, text)
        } else {
            e
        }
    })
}

fn terms(keys: &Keys<'_>) -> Result<Vec<(f64, [u16; 3])>> {
    keys.need("terms")?;
    let list = keys.list("terms")?.unwrap_or_default();
    list.iter()
        .map(|item| {
            let [c, i, j, k] = keys.scope.numbers::<4>("terms", item)?;
            let whole = |e: f64| {
                if e == e.trunc() && (0.0..=64.0).contains(&e) {
                    Ok(e as u16)
                } else {
                    Err(keys.scope.error(
                        item.line,
                        format!("'terms': exponent {e}: give [coefficient, i, j, k] with whole exponents from 0 to 64"),
                    ))
                }
            };
            Ok((c, [whole(i)?, whole(j)?, whole(k)?]))
        })
        .collect()
}

fn metaballs(keys: &Keys<'_>) -> Result<Primitive> {
    keys.need("balls")?;
    let list = keys.list("balls")?.unwrap_or_default();
    let balls = list
        .iter()
        .map(|item| {
            let count = match &item.value {
                Value::List(l) => l.len(),
                _ => 0,
            };
            if count == 5 {
                let [x, y, z, r, w] = keys.scope.numbers::<5>("balls", item)?;
                return Ok(([x, y, z], r, w));
            }
            let [x, y, z, r] = keys.scope.numbers::<4>("balls", item)?;
            Ok(([x, y, z], r, 1.0))
        })
        .collect::<Result<_>>()?;
    Ok(Primitive::Metaballs {
        balls,
        hardness: keys.number_or("hardness", 2.0)?,
    })
}
