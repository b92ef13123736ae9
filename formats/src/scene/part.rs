//! A part: one source of solidity, then what is done to it, in a fixed order.

use super::keys::Keys;
use super::scope::Scope;
use super::value::{Item, Table, Value};
use brickmarch::Result;
use brickmarch::model::{Blend, Boolean, Convert, Shape, Transform};

/// What a part can be; exactly one of them is given.
const SOURCES: [&str; 9] = [
    "shape",
    "use",
    "union",
    "intersection",
    "difference",
    "complement",
    "ricci",
    "sum",
    "contact",
];

/// # Errors
/// Names line and key.
pub(super) fn part(scope: &Scope, line: usize, table: &Table) -> Result<(Shape, usize)> {
    let keys = Keys::new(scope, line, table);
    let given: Vec<&str> = SOURCES
        .into_iter()
        .filter(|s| keys.get(s).is_some())
        .collect();
    let &[source] = given.as_slice() else {
        let all = SOURCES.join(", ");
        return Err(scope.error(
            line,
            if given.is_empty() {
                format!("this part says nothing of what it is: give one of {all}")
            } else {
                format!(
                    "this part has {}: give only one of them",
                    given.join(" and ")
                )
            },
        ));
    };
    let (shape, nodes) = match source {
        "shape" => (super::shapes::primitive(&keys)?, 1),
        "use" => scope.item(keys.need("use")?, "use")?,
        _ => combination(&keys, source)?,
    };
    let mut steps = 0;
    let mut shape = shape;
    let mut wrap = |made: Option<Wrap>| {
        if let Some(made) = made {
            steps += 1;
            let inner = Box::new(std::mem::replace(
                &mut shape,
                Shape::Boolean(Boolean::Union, Vec::new()),
            ));
            shape = match made {
                Wrap::Convert(c) => Shape::Convert(c, inner),
                Wrap::Transform(t) => Shape::Transform(t, inner),
                Wrap::Attribute(name, value) => Shape::Attribute {
                    of: inner,
                    name,
                    value,
                },
            };
        }
    };
    wrap(conversion(&keys)?);
    wrap(
        keys.number("shell")?
            .map(|thickness| Wrap::Convert(Convert::Shell { thickness })),
    );
    wrap(
        keys.number("offset")?
            .map(|by| Wrap::Convert(Convert::Offset { by })),
    );
    for step in transforms(&keys)? {
        wrap(Some(Wrap::Transform(step)));
    }
    for (name, value) in attributes(&keys)? {
        wrap(Some(Wrap::Attribute(name, value)));
    }
    keys.finish()?;
    // Numbers and conventions are checked where they are written.
    if let Err(e) = shape.convention() {
        return Err(scope.error(line, e.to_string()));
    }
    Ok((shape, nodes + steps))
}

enum Wrap {
    Convert(Convert),
    Transform(Transform),
    Attribute(String, f64),
}

fn combination(keys: &Keys<'_>, source: &'static str) -> Result<(Shape, usize)> {
    let scope = keys.scope;
    let item = keys.need(source)?;
    let items: &[Item] = match (&item.value, source) {
        (Value::List(list), _) => list,
        (_, "complement") => std::slice::from_ref(item),
        (other, _) => {
            return Err(scope.error(
                item.line,
                format!(
                    "'{source}' is {}: give a list of parts in [ ]",
                    other.noun()
                ),
            ));
        }
    };
    if items.is_empty() {
        return Err(scope.error(
            item.line,
            format!("'{source}' is an empty list: give at least one part"),
        ));
    }
    let mut parts = Vec::new();
    let mut nodes = 1usize;
    for item in items {
        let (shape, n) = scope.item(item, source)?;
        nodes += n;
        if nodes > 200_000 {
            return Err(scope.error(
                item.line,
                "too many nodes: use 'repeat' for copies".to_string(),
            ));
        }
        parts.push(shape);
    }
    let soft = [
        ("smooth", keys.number("smooth")?),
        ("circular", keys.number("circular")?),
        ("weld", keys.number("weld")?),
    ];
    let mut chosen = soft.into_iter().filter_map(|(name, v)| Some((name, v?)));
    let (first, second) = (chosen.next(), chosen.next());
    if let (Some((a, _)), Some((b, _))) = (first, second) {
        return Err(scope.error(
            keys.line,
            format!("'{a}' and '{b}' exclude each other: give one of them"),
        ));
    }
    let boolean = match source {
        "union" => Boolean::Union,
        "intersection" => Boolean::Intersection,
        "difference" => Boolean::Difference,
        "complement" => Boolean::Complement,
        _ => {
            if let Some((name, _)) = first {
                return Err(scope.error(
                    keys.line,
                    format!("'{name}' softens union, intersection and difference, not '{source}': leave it out"),
                ));
            }
            let blend = match source {
                "ricci" => Blend::Ricci {
                    power: keys.need_number("power")?,
                },
                "sum" => Blend::Sum,
                _ => Blend::Contact {
                    width: keys.need_number("width")?,
                    bulge: keys.number_or("bulge", 0.0)?,
                    gap: keys.number_or("gap", 0.0)?,
                },
            };
            return Ok((Shape::Blend(blend, parts), nodes));
        }
    };
    let shape = match first {
        None => Shape::Boolean(boolean, parts),
        Some(("smooth", width)) => Shape::Blend(Blend::Smooth { of: boolean, width }, parts),
        Some(("circular", radius)) => Shape::Blend(
            Blend::Circular {
                of: boolean,
                radius,
            },
            parts,
        ),
        Some((_, radius)) if boolean == Boolean::Union => {
            Shape::Blend(Blend::Weld { radius }, parts)
        }
        Some(_) => {
            return Err(scope.error(
                keys.line,
                format!("'weld' joins a union, not '{source}': use 'circular' for a fillet"),
            ));
        }
    };
    Ok((shape, nodes))
}

fn conversion(keys: &Keys<'_>) -> Result<Option<Wrap>> {
    Ok(
        match keys.choice("convert", &["level", "distance", "density"])? {
            None => None,
            Some("level") => Some(Wrap::Convert(Convert::ToLevel)),
            Some("distance") => Some(Wrap::Convert(Convert::ToDistance {
                slope: keys.need_number("slope")?,
            })),
            Some(_) => Some(Wrap::Convert(Convert::ToDensity {
                reach: keys.need_number("reach")?,
            })),
        },
    )
}

/// `scale`, `mirror`, `twist`, `rotate`, `move`, in this order; then the steps of `transform`.
fn transforms(keys: &Keys<'_>) -> Result<Vec<Transform>> {
    let mut out = steps(keys)?;
    if let Some(list) = keys.list("transform")? {
        for item in list {
            let Value::Table(table) = &item.value else {
                return Err(keys.scope.error(
                    item.line,
                    "'transform' holds no table: write [{ move = [1, 0, 0] }, { rotate = [0, 0, 90] }]".into(),
                ));
            };
            let inner = Keys::new(keys.scope, item.line, table);
            let found = steps(&inner)?;
            inner.finish()?;
            if found.is_empty() || table.len() > 1 + usize::from(table.contains_key("count")) {
                return Err(keys.scope.error(
                    item.line,
                    "a step of 'transform' does one thing: give one key in each { }".into(),
                ));
            }
            out.extend(found);
        }
    }
    Ok(out)
}

fn steps(keys: &Keys<'_>) -> Result<Vec<Transform>> {
    let mut out = Vec::new();
    if let Some(item) = keys.get("scale") {
        out.push(Transform::Scale(match &item.value {
            Value::List(_) => keys.scope.vector("scale", item)?,
            _ => [keys.scope.number("scale", item)?; 3],
        }));
    }
    if let Some(axis) = keys.choice("mirror", &["x", "y", "z"])? {
        let axis = usize::from(axis.as_bytes()[0] - b'x');
        out.push(Transform::Mirror { axis });
    }
    if let Some(rate) = keys.number("twist")? {
        out.push(Transform::Twist { rate });
    }
    if let Some(item) = keys.get("rotate") {
        if let Value::Table(table) = &item.value {
            let inner = Keys::new(keys.scope, item.line, table);
            out.push(Transform::Rotate {
                axis: inner.need_vector("axis")?,
                degrees: inner.need_number("degrees")?,
            });
            inner.finish()?;
        } else {
            let turns = keys.scope.vector("rotate", item)?;
            for (a, degrees) in turns.into_iter().enumerate() {
                if degrees != 0.0 {
                    let mut axis = [0.0; 3];
                    axis[a] = 1.0;
                    out.push(Transform::Rotate { axis, degrees });
                }
            }
            if out.is_empty() {
                out.push(Transform::Move([0.0; 3]));
            }
        }
    }
    if let Some(by) = keys.vector("move")? {
        out.push(Transform::Move(by));
    }
    if let Some(step) = keys.vector("repeat")? {
        let count = match keys.vector("count")? {
            None => [0; 3],
            Some(count) => {
                if count
                    .iter()
                    .any(|c| *c != c.trunc() || *c < 0.0 || *c > 1e6)
                {
                    return Err(keys.scope.error(
                        keys.line,
                        format!(
                            "'count' is {count:?}: give whole numbers from 0 (no end) to 1000000"
                        ),
                    ));
                }
                count.map(|c| c as u32)
            }
        };
        out.push(Transform::Repeat { step, count });
    }
    if let Some(count) = keys.whole("around", 1_000_000)? {
        out.push(Transform::Around { count });
    }
    Ok(out)
}

fn attributes(keys: &Keys<'_>) -> Result<Vec<(String, f64)>> {
    let mut out = Vec::new();
    if let Some(item) = keys.get("color") {
        let rgb = match &item.value {
            Value::Text(text) => hex(text).ok_or_else(|| {
                keys.scope.error(
                    item.line,
                    format!(
                        "'color' is \"{text}\": give \"#rrggbb\" or [red, green, blue] from 0 to 1"
                    ),
                )
            })?,
            _ => keys.scope.vector("color", item)?,
        };
        if rgb.iter().any(|c| !(0.0..=1.0).contains(c)) {
            return Err(keys.scope.error(
                item.line,
                format!("'color' is {rgb:?}: give red, green, blue from 0 to 1"),
            ));
        }
        let names = ["red", "green", "blue"].map(String::from);
        out.extend(names.into_iter().zip(rgb));
    }
    if let Some(item) = keys.get("attributes") {
        let Value::Table(table) = &item.value else {
            return Err(keys.scope.error(
                item.line,
                "'attributes' is no table: write attributes = { name = value }".into(),
            ));
        };
        for (name, item) in table {
            out.push((name.clone(), keys.scope.number(name, item)?));
        }
    }
    Ok(out)
}

fn hex(text: &str) -> Option<[f64; 3]> {
    let digits = text.strip_prefix('#')?;
    if digits.len() != 6 || !digits.bytes().all(|b| b.is_ascii_hexdigit()) {
        return None;
    }
    let number = u32::from_str_radix(digits, 16).ok()?;
    Some([16, 8, 0].map(|shift| f64::from(number >> shift & 255) / 255.0))
}
