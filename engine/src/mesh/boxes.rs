//! A tree of boxes over triangles, to find those that are near each other.
//!
//! Triangles are sorted along a space-filling curve and taken in groups of eight; four groups make a
//! node, and so on. Every box is that of what is below, so that the tree serves triangles of very
//! different sizes.

/// Lowest and highest coordinates.
pub(super) type Bounds = [[f32; 3]; 2];

/// Triangles of a group.
const GROUP: usize = 8;
/// Children of a node.
const FAN: usize = 4;

/// The bounds of nothing.
pub(super) const NOTHING: Bounds = [[f32::INFINITY; 3], [f32::NEG_INFINITY; 3]];

/// Bytes a triangle while the tree is made and used.
pub(super) const TREE_BYTES: u64 = 16 + 4 + 24 / GROUP as u64 * 4 / 3 + 1;

#[inline]
pub(super) fn bounds_of(corners: &[[f32; 3]; 3]) -> Bounds {
    let [a, b, c] = corners;
    let mut bounds = NOTHING;
    for i in 0..3 {
        bounds[0][i] = a[i].min(b[i]).min(c[i]);
        bounds[1][i] = a[i].max(b[i]).max(c[i]);
    }
    bounds
}

pub(super) fn union(a: Bounds, b: Bounds) -> Bounds {
    let mut out = a;
    for i in 0..3 {
        out[0][i] = a[0][i].min(b[0][i]);
        out[1][i] = a[1][i].max(b[1][i]);
    }
    out
}

#[inline]
pub(super) fn touch(a: &Bounds, b: &Bounds) -> bool {
    // Without branches.
    let mut apart = false;
    for i in 0..3 {
        apart |= a[0][i] > b[1][i] || b[0][i] > a[1][i];
    }
    !apart
}

/// The tree over a list of triangles.
pub(super) struct Boxes {
    /// Triangles in the order of the curve.
    order: Vec<u32>,
    /// Boxes of the groups, then of the nodes above them, level by level, up to one.
    levels: Vec<Vec<Bounds>>,
}

impl Boxes {
    /// The tree over the triangles `numbers`, which have finite corners.
    pub(super) fn new(
        numbers: impl Iterator<Item = u32>,
        corners: impl Fn(u32) -> [[f32; 3]; 3],
        whole: Bounds,
    ) -> Self {
        let place = |n: u32| {
            let [low, high] = bounds_of(&corners(n));
            std::array::from_fn(|a| {
                let wide = f64::from(whole[1][a]) - f64::from(whole[0][a]);
                let middle = (f64::from(low[a]) + f64::from(high[a])) / 2.0;
                let part = (middle - f64::from(whole[0][a])) / wide.max(f64::MIN_POSITIVE);
                (part * f64::from((1u32 << 21) - 1)) as u64
            })
        };
        let mut keys: Vec<(u64, u32)> = numbers.map(|n| (curve(place(n)), n)).collect();
        keys.sort_unstable();
        let order: Vec<u32> = keys.iter().map(|&(_, n)| n).collect();
        drop(keys);
        let group = |numbers: &[u32]| {
            let boxes = numbers.iter().map(|&n| bounds_of(&corners(n)));
            boxes.fold(NOTHING, union)
        };
        let mut levels = vec![order.chunks(GROUP).map(group).collect::<Vec<Bounds>>()];
        while let Some(last) = levels.last().filter(|last| last.len() > 1) {
            let above = last
                .chunks(FAN)
                .map(|boxes| boxes.iter().copied().fold(NOTHING, union));
            let above = above.collect();
            levels.push(above);
        }
        Self { order, levels }
    }

    /// Number of groups.
    pub(super) fn groups(&self) -> usize {
        self.levels[0].len()
    }

    /// The triangles of a group.
    pub(super) fn group(&self, g: usize) -> &[u32] {
        &self.order[g * GROUP..self.order.len().min((g + 1) * GROUP)]
    }

    /// Calls `visit` for every group from `g` on whose box touches that of `g`.
    pub(super) fn neighbours(
        &self,
        g: usize,
        stack: &mut Vec<(u32, u32)>,
        mut visit: impl FnMut(usize),
    ) {
        let own = self.levels[0][g];
        stack.clear();
        stack.push((self.levels.len() as u32 - 1, 0));
        while let Some((level, node)) = stack.pop() {
            // The last group below a node.
            let last = (node as u64 + 1) * (FAN as u64).pow(level) - 1;
            if last < g as u64 || !touch(&own, &self.levels[level as usize][node as usize]) {
                continue;
            }
            if level == 0 {
                visit(node as usize);
                continue;
            }
            let below = self.levels[level as usize - 1].len() as u32;
            let first = node * FAN as u32;
            for child in first..below.min(first + FAN as u32) {
                stack.push((level - 1, child));
            }
        }
    }

    /// Calls `visit` for groups near `p`, nearer ones first as far as boxes tell, as long as a box
    /// may hold something whose square of the distance is below what `visit` gave last. The first
    /// call is without a group.
    pub(super) fn visit_near(
        &self,
        p: [f32; 3],
        stack: &mut Vec<(u32, u32, f32)>,
        mut visit: impl FnMut(Option<&[u32]>) -> f64,
    ) {
        // A little less than the square, so that rounding hides nothing.
        let square = |b: &Bounds| -> f32 {
            let off = |i: usize| (b[0][i] - p[i]).max(p[i] - b[1][i]).max(0.0);
            (off(0) * off(0) + off(1) * off(1) + off(2) * off(2)) * 0.999_99
        };
        let mut most = visit(None);
        stack.clear();
        stack.push((self.levels.len() as u32 - 1, 0, 0.0));
        while let Some((level, node, least)) = stack.pop() {
            if f64::from(least) >= most {
                continue;
            }
            if level == 0 {
                most = visit(Some(self.group(node as usize)));
                continue;
            }
            let below = &self.levels[level as usize - 1];
            let first = node as usize * FAN;
            let begin = stack.len();
            for child in first..below.len().min(first + FAN) {
                let square = square(&below[child]);
                if f64::from(square) < most {
                    stack.push((level - 1, child as u32, square));
                }
            }
            stack[begin..].sort_unstable_by(|a, b| b.2.total_cmp(&a.2));
        }
    }
}

/// Interleaves the bits of three numbers below 2^21.
fn curve(place: [u64; 3]) -> u64 {
    let spread = |mut v: u64| {
        v = (v | v << 32) & 0x1f_0000_0000_ffff;
        v = (v | v << 16) & 0x1f_0000_ff00_00ff;
        v = (v | v << 8) & 0x100f_00f0_0f00_f00f;
        v = (v | v << 4) & 0x10c3_0c30_c30c_30c3;
        (v | v << 2) & 0x1249_2492_4924_9249
    };
    spread(place[0]) | spread(place[1]) << 1 | spread(place[2]) << 2
}
