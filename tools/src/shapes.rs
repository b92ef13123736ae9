//! How good triangles are, in words and for programs; of a passing mesh before and after its
//! vertices were moved.

use brickmarch::mesh::{
    Layout, PERCENTILES, Piece, SLIVER_DEG, ShapeCount, Shapes, Spread, Totals,
};
use brickmarch::{MeshSink, Result};
use serde_json::{Value, json};
use std::sync::Mutex;

/// Counts the shapes of the triangles of a passing mesh.
#[derive(Debug, Default)]
pub(crate) struct ShapeTally {
    both: Mutex<[ShapeCount; 2]>,
}

impl ShapeTally {
    /// The shapes before and after, after `finish`.
    pub(crate) fn shapes(self) -> [Shapes; 2] {
        let both = self.both.into_inner().expect("no writer panicked");
        both.map(|count| count.shapes())
    }
}

impl MeshSink for ShapeTally {
    fn begin(&mut self, _layout: Layout) -> Result<()> {
        *self = ShapeTally::default();
        Ok(())
    }

    fn write(&self, piece: &Piece) -> Result<()> {
        let mut here = [ShapeCount::default(), ShapeCount::default()];
        for t in &piece.triangles {
            if !piece.unmoved.is_empty() {
                here[0].add(&t.map(|v| piece.unmoved[v as usize]));
            }
            here[1].add(&t.map(|v| piece.positions[v as usize]));
        }
        let mut both = self.both.lock().expect("no writer panicked");
        for (all, here) in both.iter_mut().zip(&here) {
            all.join(here);
        }
        Ok(())
    }

    fn finish(&mut self, _totals: Totals) -> Result<()> {
        Ok(())
    }
}

/// Least and percentiles in words.
pub(crate) fn spread(s: &Spread, digits: usize) -> String {
    let each = PERCENTILES.iter().zip(s.percentiles);
    let each: Vec<String> = each.map(|(p, v)| format!("{v:.digits$} ({p} %)")).collect();
    format!("{:.digits$} least, {}", s.least, each.join(", "))
}

/// Two lines before and after; before only where that is known, as it is not where a mesh waited
/// for its components.
pub(crate) fn text([before, after]: &[Shapes; 2]) -> String {
    let mut text = String::new();
    for (when, s) in [("before", before), ("after", after)] {
        if s.measured == 0 {
            continue;
        }
        let part = 100.0 * s.slivers as f64 / s.measured as f64;
        text += &format!(
            "  {when}: min angle {}; {part:.3} % below {SLIVER_DEG} degrees\n  {when}: radius ratio {}\n",
            spread(&s.min_angle_deg, 1),
            spread(&s.radius_ratio, 3),
        );
    }
    text
}

/// The same for programs.
pub(crate) fn json([before, after]: &[Shapes; 2]) -> Value {
    let of = |s: &Shapes| match s.measured {
        0 => Value::Null,
        _ => shapes_json(s),
    };
    json!({"before": of(before), "after": of(after)})
}

/// Shapes of the triangles of one mesh, for programs.
pub(crate) fn shapes_json(shapes: &Shapes) -> Value {
    let spread = |s: &Spread| {
        let mut json = json!({ "least": s.least });
        for (p, value) in PERCENTILES.iter().zip(s.percentiles) {
            json[format!("p{p}")] = json!(value);
        }
        json
    };
    json!({
        "min_angle_deg": spread(&shapes.min_angle_deg), "radius_ratio": spread(&shapes.radius_ratio),
        "slivers": shapes.slivers, "sliver_deg": SLIVER_DEG, "measured": shapes.measured,
    })
}
