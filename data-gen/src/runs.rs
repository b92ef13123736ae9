//! Connected components of a stream of bit slices: runs of equal bits joined by union-find, with
//! labels of two slices at a time.

/// Counts components of inside and outside, 6-connected.
pub(crate) struct Components {
    size: [u32; 3],
    /// Runs of the last slice, with labels below `parents.len()`.
    before: Runs,
    now: Runs,
    /// Union-find over the labels of two slices.
    parents: Vec<u32>,
    /// Per root: whether the piece reaches the border of the lattice.
    border: Vec<bool>,
    /// Per root: whether the piece is inside.
    inside: Vec<bool>,
    slices: u32,
    found: Found,
}

/// Number of components.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Found {
    pub(crate) inside: u64,
    pub(crate) outside: u64,
    /// Components of the outside that do not reach the border.
    pub(crate) outside_inner: u64,
}

/// Runs of a slice: row `j` has `runs[rows[j]..rows[j + 1]]`, alternating between the sides.
#[derive(Default)]
struct Runs {
    runs: Vec<Run>,
    rows: Vec<usize>,
}

#[derive(Clone, Copy)]
struct Run {
    end: u32,
    label: u32,
}

impl Runs {
    fn row(&self, j: usize) -> &[Run] {
        &self.runs[self.rows[j]..self.rows[j + 1]]
    }
}

impl Components {
    pub(crate) fn new(size: [u32; 3]) -> Self {
        Self {
            size,
            before: Runs::default(),
            now: Runs::default(),
            parents: Vec::new(),
            border: Vec::new(),
            inside: Vec::new(),
            slices: 0,
            found: Found::default(),
        }
    }

    /// Takes the next slice, `words` words per row.
    pub(crate) fn push(&mut self, slice: &[u64], words: usize) {
        let old_labels = self.parents.len();
        let end_slice = self.slices == 0 || self.slices + 1 == self.size[2];
        let last_row = self.size[1] as usize - 1;
        self.now.runs.clear();
        self.now.rows.clear();
        for (j, row) in slice.chunks(words).enumerate() {
            self.now.rows.push(self.now.runs.len());
            self.cut_row(row, end_slice || j == 0 || j == last_row);
        }
        self.now.rows.push(self.now.runs.len());
        for j in 0..=last_row {
            if j > 0 {
                join(
                    &mut self.parents,
                    &self.inside,
                    self.now.row(j - 1),
                    self.now.row(j),
                );
            }
            if self.slices > 0 {
                join(
                    &mut self.parents,
                    &self.inside,
                    self.before.row(j),
                    self.now.row(j),
                );
            }
        }
        self.retire(old_labels);
        std::mem::swap(&mut self.before, &mut self.now);
        self.slices += 1;
    }

    pub(crate) fn finish(mut self) -> Found {
        self.now.runs.clear();
        let labels = self.parents.len();
        self.retire(labels);
        self.found
    }

    /// Cuts a row into runs, each with a label of its own.
    fn cut_row(&mut self, row: &[u64], border: bool) {
        let length = self.size[0];
        let mut start = 0;
        while start < length {
            let side = row[(start / 64) as usize] >> (start % 64) & 1 == 1;
            let end = run_end(row, start, side).min(length);
            let label = u32::try_from(self.parents.len()).expect("runs of two slices fit 32 bits");
            self.parents.push(label);
            self.inside.push(side);
            self.border.push(border || start == 0 || end == length);
            self.now.runs.push(Run { end, label });
            start = end;
        }
    }

    /// Counts the components that do not go on in the newest slice, and numbers those that do anew.
    fn retire(&mut self, old_labels: usize) {
        let count = self.parents.len();
        for label in 0..count {
            let root = find(&mut self.parents, label as u32) as usize;
            self.border[root] |= self.border[label];
        }
        const NONE: u32 = u32::MAX;
        let mut names = vec![NONE; count];
        let (mut parents, mut border, mut inside) = (Vec::new(), Vec::new(), Vec::new());
        for run in &mut self.now.runs {
            let root = find(&mut self.parents, run.label) as usize;
            if names[root] == NONE {
                names[root] = parents.len() as u32;
                parents.push(names[root]);
                border.push(self.border[root]);
                inside.push(self.inside[root]);
            }
            run.label = names[root];
        }
        for label in 0..old_labels {
            let root = find(&mut self.parents, label as u32) as usize;
            if names[root] == NONE {
                names[root] = 0;
                if self.inside[root] {
                    self.found.inside += 1;
                } else {
                    self.found.outside += 1;
                    self.found.outside_inner += u64::from(!self.border[root]);
                }
            }
        }
        (self.parents, self.border, self.inside) = (parents, border, inside);
    }
}

/// First place after `start` whose bit is not `side`, or beyond the end.
fn run_end(row: &[u64], start: u32, side: bool) -> u32 {
    let mut word = (start / 64) as usize;
    let turned = |w: u64| if side { !w } else { w };
    let mut bits = turned(row[word]) & u64::MAX << (start % 64);
    while bits == 0 {
        word += 1;
        match row.get(word) {
            Some(&next) => bits = turned(next),
            None => return word as u32 * 64,
        }
    }
    word as u32 * 64 + bits.trailing_zeros()
}

/// Joins the runs of two neighbouring rows that overlap and lie on one side.
fn join(parents: &mut [u32], inside: &[bool], a: &[Run], b: &[Run]) {
    let (mut m, mut n) = (0, 0);
    while m < a.len() && n < b.len() {
        let (p, q) = (a[m], b[n]);
        if inside[p.label as usize] == inside[q.label as usize] {
            let (p, q) = (find(parents, p.label), find(parents, q.label));
            // The lower label is the root: older, and the same for any order of joining.
            parents[p.max(q) as usize] = p.min(q);
        }
        if p.end <= q.end {
            m += 1;
        }
        if q.end <= p.end {
            n += 1;
        }
    }
}

fn find(parents: &mut [u32], mut label: u32) -> u32 {
    while parents[label as usize] != label {
        let up = parents[parents[label as usize] as usize];
        parents[label as usize] = up;
        label = up;
    }
    label
}
