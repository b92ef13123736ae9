//! The tree of a model: what a scene file says, as data.

use super::build::Built;
use super::expression::Expression;
use super::graph::Graph;
use super::profile::Profile;
use super::sampled::Sampled;
use crate::error::Result;
use crate::sample::{Inside, Kind};

/// What the values of a shape mean, and so what it may be combined with.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Convention {
    /// Negative inside; changes by at most the way that is gone, so it is a lower bound of the
    /// distance to the surface. What offsets, shells, smooth blends and narrow bands need.
    Distance,
    /// Negative inside, of any scale: polynomials, formulas, triply periodic surfaces.
    Level,
    /// Inside is `value >= iso`: metaballs, scans.
    Density {
        /// Where the surface is.
        iso: f64,
    },
}

impl Convention {
    /// Name in scene files and messages.
    pub fn name(self) -> &'static str {
        match self {
            Convention::Distance => "distance",
            Convention::Level => "level",
            Convention::Density { .. } => "density",
        }
    }

    /// The kind of volume that holds such values.
    pub fn kind(self) -> Kind {
        match self {
            Convention::Density { .. } => Kind::Density,
            _ => Kind::Distance,
        }
    }

    /// Where the surface is.
    pub fn iso(self) -> f32 {
        match self {
            Convention::Density { iso } => iso as f32,
            _ => 0.0,
        }
    }

    /// Which side is inside.
    pub fn inside(self) -> Inside {
        self.kind().inside()
    }
}

/// A solid, as a tree. Lengths are in world units, angles in degrees.
#[derive(Clone, Debug)]
pub enum Shape {
    /// A solid of its own.
    Primitive(Primitive),
    /// A solid, placed or bent.
    Transform(Transform, Box<Shape>),
    /// Several solids as sets.
    Boolean(Boolean, Vec<Shape>),
    /// Several solids with soft passages.
    Blend(Blend, Vec<Shape>),
    /// Other values with the same surface, or a surface beside it.
    Convert(Convert, Box<Shape>),
    /// A named number that every point of the solid carries.
    Attribute {
        /// The solid.
        of: Box<Shape>,
        /// Name of the attribute; `red`, `green` and `blue` (0 to 1) are the colour.
        name: String,
        /// Its value.
        value: f64,
    },
}

/// Solids that are not made from others. Centred at the origin unless they say otherwise.
#[derive(Clone, Debug)]
pub enum Primitive {
    /// True distance.
    Sphere {
        /// Radius.
        radius: f64,
    },
    /// `(|p|^2 - r^2) / 2r`: a level, smooth everywhere.
    QuadraticSphere {
        /// Radius.
        radius: f64,
    },
    /// A lower bound of the distance.
    Ellipsoid {
        /// Half axes.
        radii: [f64; 3],
    },
    /// True distance.
    Box {
        /// Full edges.
        size: [f64; 3],
        /// Radius of the edges, 0 for sharp ones; the full size includes it.
        rounding: f64,
    },
    /// True distance. Along z.
    Cylinder {
        /// Radius.
        radius: f64,
        /// Full height.
        height: f64,
    },
    /// True distance: all points within a radius of a segment.
    Capsule {
        /// One end.
        from: [f64; 3],
        /// The other end.
        to: [f64; 3],
        /// Radius.
        radius: f64,
    },
    /// Lower bound of the distance, exact inside. Along z, cut at both ends.
    Cone {
        /// Radius at the bottom.
        bottom: f64,
        /// Radius at the top.
        top: f64,
        /// Full height.
        height: f64,
    },
    /// True distance. Around z.
    Torus {
        /// From the centre to the middle of the tube.
        major: f64,
        /// Radius of the tube.
        minor: f64,
    },
    /// True distance: the side that the normal points away from.
    HalfSpace {
        /// Outward direction, of any length.
        normal: [f64; 3],
        /// Distance of the plane from the origin along the normal.
        offset: f64,
    },
    /// True distance: an outline in the xy plane, extended along z.
    Extrude {
        /// The outline.
        profile: Profile,
        /// Full height.
        height: f64,
    },
    /// True distance where the outline stays on one side of the axis: an outline in (distance from
    /// z, z), turned around z.
    Revolve {
        /// The outline.
        profile: Profile,
    },
    /// A triply periodic surface; a level.
    Periodic {
        /// Which one.
        surface: Periodic,
        /// Length of a period.
        period: f64,
        /// Wall around the surface, about this thick; 0 for the solid on one side.
        thickness: f64,
    },
    /// `sum of c x^i y^j z^k`; a level, negative inside.
    Polynomial {
        /// Coefficient and exponents of each term.
        terms: Vec<(f64, [u16; 3])>,
    },
    /// A formula in x, y, z.
    Formula {
        /// The formula.
        value: Expression,
        /// What its value means.
        convention: Convention,
    },
    /// A density: the sum of bumps around points (Blinn 1982).
    Metaballs {
        /// Centre, radius (where a ball alone has its surface) and weight of each.
        balls: Vec<([f64; 3], f64, f64)>,
        /// How steep the bumps are: larger is harder; 2 is usual.
        hardness: f64,
    },
    /// The ground below a height field: a level.
    Heights {
        /// Heights over index x, y; one sample along z.
        heights: Sampled,
        /// Factor on the heights.
        factor: f64,
    },
    /// The samples of another field: a volume, a raw file.
    Sampled {
        /// The samples.
        samples: Sampled,
        /// What they mean.
        convention: Convention,
    },
}

/// Triply periodic surfaces by their usual approximations with sines.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum Periodic {
    Gyroid,
    SchwarzP,
    Diamond,
    Neovius,
    Iwp,
    Lidinoid,
}

impl Periodic {
    /// Every one of them.
    pub const ALL: [Periodic; 6] = [
        Periodic::Gyroid,
        Periodic::SchwarzP,
        Periodic::Diamond,
        Periodic::Neovius,
        Periodic::Iwp,
        Periodic::Lidinoid,
    ];

    /// Name in scene files.
    pub fn name(self) -> &'static str {
        match self {
            Periodic::Gyroid => "gyroid",
            Periodic::SchwarzP => "schwarz-p",
            Periodic::Diamond => "diamond",
            Periodic::Neovius => "neovius",
            Periodic::Iwp => "iwp",
            Periodic::Lidinoid => "lidinoid",
        }
    }
}

/// How a solid is placed or bent.
#[derive(Clone, Debug, PartialEq)]
pub enum Transform {
    /// By this vector.
    Move([f64; 3]),
    /// Around a line through the origin, counter-clockwise seen against its direction.
    Rotate {
        /// Direction of the line.
        axis: [f64; 3],
        /// Angle.
        degrees: f64,
    },
    /// Per axis. A distance stays a lower bound of the distance.
    Scale([f64; 3]),
    /// What is on the positive side of an axis, and its mirror image.
    Mirror {
        /// 0, 1 or 2.
        axis: usize,
    },
    /// Copies at `0, step, 2 step, ...` along each axis. Each point sees the copy of its own cell,
    /// so the solid should fit in a cell of this size around the origin.
    Repeat {
        /// Distance of copies; 0 for an axis without copies.
        step: [f64; 3],
        /// Number of copies per axis; 0 for no end, in both directions.
        count: [u32; 3],
    },
    /// Copies around z, the first one where the solid is; it should lie around the positive x axis.
    Around {
        /// Number of copies.
        count: u32,
    },
    /// Turns with height: a level.
    Twist {
        /// Degrees per unit of z.
        rate: f64,
    },
}

/// Set operations. `Complement` takes one solid, `Difference` the first one without the others.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum Boolean {
    Complement,
    Union,
    Intersection,
    Difference,
}

/// Soft set operations.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Blend {
    /// Of distances: a passage of a parabola, C1 (Quilez).
    Smooth {
        /// Which set operation.
        of: Boolean,
        /// Passage where the values differ by less than this.
        width: f64,
    },
    /// Of distances: a passage of a circle, C1: the fillet between two planes at a right angle.
    Circular {
        /// Which set operation.
        of: Boolean,
        /// Radius of the fillet.
        radius: f64,
    },
    /// Of densities, not negative: `(sum f^p)^(1/p)` (Ricci 1973); a negative power intersects.
    Ricci {
        /// The power: near 1 very soft, large nearly sharp.
        power: f64,
    },
    /// Of densities: their sum (Blinn 1982).
    Sum,
    /// Of two distances: where they meet, both give way up to a common contact surface, and swell
    /// beside it (Cani-Gascuel 1993).
    Contact {
        /// How far from the other solid the swelling reaches.
        width: f64,
        /// Its height.
        bulge: f64,
        /// Gap that is left between the two.
        gap: f64,
    },
    /// Of distances: the union with a bead along the curve where the two surfaces meet.
    Weld {
        /// Radius of the bead.
        radius: f64,
    },
}

/// Explicit changes of what values mean.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Convert {
    /// Density to level: `iso - value`.
    ToLevel,
    /// Level to distance, divided by a bound of its slope.
    ToDistance {
        /// Most that the value changes per unit of way.
        slope: f64,
    },
    /// Distance to density: from 1 well inside to 0 well outside, C1, with isovalue 0.5.
    ToDensity {
        /// How far from the surface the passage reaches.
        reach: f64,
    },
    /// Of a distance: the surface moved outwards.
    Offset {
        /// How far; negative moves inwards.
        by: f64,
    },
    /// Of a distance: a wall on the surface.
    Shell {
        /// Its thickness, half on each side.
        thickness: f64,
    },
}

impl Shape {
    /// Moved by `by`.
    #[must_use]
    pub fn moved(self, by: [f64; 3]) -> Shape {
        Shape::Transform(Transform::Move(by), Box::new(self))
    }

    /// With an attribute.
    #[must_use]
    pub fn with(self, name: &str, value: f64) -> Shape {
        Shape::Attribute {
            of: Box::new(self),
            name: name.to_string(),
            value,
        }
    }

    /// What its values mean.
    ///
    /// # Errors
    /// When a number makes no sense, or solids are combined that cannot be.
    pub fn convention(&self) -> Result<Convention> {
        let mut graph = Graph::default();
        let point = graph.axes();
        Ok(self.build(&mut graph, point, &[])?.convention)
    }

    /// Names of all attributes, in order.
    pub fn attribute_names(&self) -> Vec<String> {
        let mut names = std::collections::BTreeSet::new();
        self.visit(&mut |shape| {
            if let Shape::Attribute { name, .. } = shape {
                names.insert(name.clone());
            }
        });
        names.into_iter().collect()
    }

    /// Calls `each` with every part of the tree.
    fn visit(&self, each: &mut dyn FnMut(&Shape)) {
        each(self);
        match self {
            Shape::Primitive(_) => {}
            Shape::Transform(_, of) | Shape::Convert(_, of) | Shape::Attribute { of, .. } => {
                of.visit(each);
            }
            Shape::Boolean(_, of) | Shape::Blend(_, of) => of.iter().for_each(|s| s.visit(each)),
        }
    }

    /// The tree as indented text, one line for each part.
    pub fn outline(&self) -> String {
        let mut out = String::new();
        self.outline_into(0, &mut out);
        out
    }

    fn outline_into(&self, depth: usize, out: &mut String) {
        let of: &[Shape] = match self {
            Shape::Primitive(_) => &[],
            Shape::Transform(_, of) | Shape::Convert(_, of) | Shape::Attribute { of, .. } => {
                std::slice::from_ref(of)
            }
            Shape::Boolean(_, of) | Shape::Blend(_, of) => of,
        };
        let line = match self {
            Shape::Primitive(p) => format!("{p:?}"),
            Shape::Transform(t, _) => format!("{t:?}"),
            Shape::Boolean(b, _) => format!("{b:?}"),
            Shape::Blend(b, _) => format!("{b:?}"),
            Shape::Convert(c, _) => format!("{c:?}"),
            Shape::Attribute { name, value, .. } => format!("{name} = {value}"),
        };
        let short: String = line.chars().take(160).collect();
        out.push_str(&format!("{:1$}{short}\n", "", 2 * depth));
        of.iter().for_each(|s| s.outline_into(depth + 1, out));
    }

    /// Adds the operations of this tree at `point` to `graph`.
    pub(super) fn build(
        &self,
        graph: &mut Graph,
        point: [super::graph::Id; 3],
        names: &[String],
    ) -> Result<Built> {
        graph.check_size()?;
        match self {
            Shape::Primitive(p) => p.build(graph, point, names),
            Shape::Transform(t, of) => t.build(of, graph, point, names),
            Shape::Boolean(b, of) => {
                let parts = build_all(of, graph, point, names)?;
                super::combine::boolean(*b, parts, graph)
            }
            Shape::Blend(b, of) => {
                let parts = build_all(of, graph, point, names)?;
                super::blend::blend(*b, parts, graph)
            }
            Shape::Convert(c, of) => {
                let part = of.build(graph, point, names)?;
                super::combine::convert(*c, part, graph)
            }
            Shape::Attribute { of, name, value } => {
                let mut part = of.build(graph, point, names)?;
                super::build::finite(&format!("attribute {name}"), &[*value])?;
                if let Some(at) = names.iter().position(|n| n == name) {
                    part.attributes[at] = graph.constant(*value);
                }
                Ok(part)
            }
        }
    }
}

fn build_all(
    of: &[Shape],
    graph: &mut Graph,
    point: [super::graph::Id; 3],
    names: &[String],
) -> Result<Vec<Built>> {
    of.iter().map(|s| s.build(graph, point, names)).collect()
}
