//! Sets of numbered things that are joined two by two.

/// Joins the sets of `a` and `b` under the lower root; gives the root and whether they were apart.
#[inline]
pub(super) fn unite(parents: &mut [u32], a: u32, b: u32) -> (u32, bool) {
    let (a, b) = (root(parents, a), root(parents, b));
    let (low, high) = (a.min(b), a.max(b));
    parents[high as usize] = low;
    (low, low != high)
}

/// The lowest of the set of `v`.
#[inline]
pub(super) fn root(parents: &mut [u32], mut v: u32) -> u32 {
    loop {
        let parent = parents[v as usize];
        if parent == v {
            return v;
        }
        let above = parents[parent as usize];
        parents[v as usize] = above;
        v = above;
    }
}
