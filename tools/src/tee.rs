//! One mesh into several sinks at once.

use brickmarch::mesh::{Layout, Piece, Totals};
use brickmarch::{MeshSink, Result};

/// Passes everything on, to each sink in order. A sink that is not to write normals or keys that
/// another one needs is given a layout without them.
#[derive(Default)]
pub(crate) struct Tee<'a> {
    sinks: Vec<(&'a mut dyn MeshSink, Layout)>,
}

impl<'a> Tee<'a> {
    /// Adds a sink, with what it may carry of what the mesh has.
    pub(crate) fn add(&mut self, sink: &'a mut dyn MeshSink, carries: Layout) {
        self.sinks.push((sink, carries));
    }
}

impl MeshSink for Tee<'_> {
    fn capacity(&self) -> Totals {
        let all = self.sinks.iter().map(|(sink, _)| sink.capacity());
        all.reduce(|a, b| Totals {
            vertices: a.vertices.min(b.vertices),
            triangles: a.triangles.min(b.triangles),
        })
        .unwrap_or(Totals {
            vertices: u64::MAX,
            triangles: u64::MAX,
        })
    }

    fn begin(&mut self, layout: Layout) -> Result<()> {
        self.sinks.iter_mut().try_for_each(|(sink, wanted)| {
            sink.begin(Layout {
                normals: layout.normals && wanted.normals,
                keys: layout.keys && wanted.keys,
            })
        })
    }

    fn write(&self, piece: &Piece) -> Result<()> {
        self.sinks
            .iter()
            .try_for_each(|(sink, _)| sink.write(piece))
    }

    fn finish(&mut self, totals: Totals) -> Result<()> {
        self.sinks
            .iter_mut()
            .try_for_each(|(sink, _)| sink.finish(totals))
    }
}
