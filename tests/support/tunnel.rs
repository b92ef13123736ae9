//! Does a cell hold a tunnel? By whole numbers of any size, ties broken by a real step.
//!
//! On each axis the determinant of the slice at `u` is a quadratic. Where it is zero the level set
//! of the slice is two lines. If all six roots lie in the cell they bound a box at six corners of
//! which the interpolant is zero. If it has one sign at the other two, the level set goes around
//! the box: a tunnel.

use super::whole::Whole;

/// Corners less the isovalue are multiples of 2^-149.
const GRAIN: i32 = 149;

/// Room below that for a step of the level that is too small to change any sign but zero: signs are
/// those of sums of products of at most four corners, each below 2^280 grains.
const ROOM: i32 = 1200;

/// Whether the middle of a tunnel is above the isovalue; `None` without a tunnel. Corner `i` sits at
/// x = i & 1, y = i >> 1 & 1, z = i >> 2 & 1.
pub(crate) fn tunnel(offsets: &[f64; 8]) -> Option<bool> {
    if plainly_none(offsets) {
        return None;
    }
    let step = Whole::small(1);
    let corner: Vec<Whole> = offsets
        .iter()
        .map(|&v| Whole::scaled(v, GRAIN + ROOM).plus(&step))
        .collect();
    let two = Whole::small(2);
    let mut sides = 1;
    let mut middle = Vec::new();
    for axis in 0..3 {
        let (b, c) = ((axis + 1) % 3, (axis + 2) % 3);
        let at = |u: usize, v: usize, w: usize| &corner[u << axis | v << b | w << c];
        let mixed = |u: usize, v: usize| {
            at(u, 0, 0)
                .times(at(v, 1, 1))
                .minus(&at(u, 1, 0).times(at(v, 0, 1)))
        };
        // q0 (1-u)^2 + r u (1-u) + q1 u^2
        let (q0, q1) = (mixed(0, 0), mixed(1, 1));
        let side = q0.sign();
        if side == 0 || q1.sign() != side {
            return None;
        }
        let r = mixed(0, 1).plus(&mixed(1, 0));
        let four = two.times(&two);
        let discriminant = r.times(&r).minus(&four.times(&q0.times(&q1)));
        if r.sign() != -side || discriminant.sign() <= 0 {
            return None;
        }
        sides *= side;
        // Half-way between the roots, as a fraction with a positive denominator.
        let over = two.times(&q0).minus(&r);
        let under = two.times(&q0.plus(&q1).minus(&r));
        let sign = Whole::small(under.sign());
        middle.push((over.times(&sign), under.times(&sign)));
    }
    if sides > 0 {
        return None;
    }
    let mut value = Whole::default();
    for (i, v) in corner.iter().enumerate() {
        let weights = middle.iter().enumerate().map(|(axis, (over, under))| {
            if i >> axis & 1 == 1 {
                over.clone()
            } else {
                under.minus(over)
            }
        });
        value = value.plus(&weights.fold(v.clone(), |product, w| product.times(&w)));
    }
    Some(value.sign() > 0)
}

/// Whether some axis has a root outside the cell by so much that rounding does not matter.
fn plainly_none(offsets: &[f64; 8]) -> bool {
    (0..3).any(|axis| {
        let (b, c) = ((axis + 1) % 3, (axis + 2) % 3);
        let [low, high] = [0, 1].map(|u| {
            let at = |v: usize, w: usize| offsets[u << axis | v << b | w << c];
            let (p, q) = (at(0, 0) * at(1, 1), at(1, 0) * at(0, 1));
            let sure = (p - q).abs() > 1e-9 * (p.abs() + q.abs());
            if sure { (p - q).signum() } else { 0.0 }
        });
        low * high < 0.0
    })
}

#[cfg(test)]
mod tests {
    use super::tunnel;

    #[test]
    fn opposite_corners_join_when_they_are_strong() {
        let cell = |ends: f64| [ends, -1.0, -1.0, -1.0, -1.0, -1.0, -1.0, ends];
        assert_eq!(tunnel(&cell(1.0)), None);
        assert_eq!(tunnel(&cell(20.0)), Some(true));
        assert_eq!(tunnel(&cell(20.0).map(|v| -v)), Some(false));
        assert_eq!(tunnel(&cell(3e38).map(|v| v * 1.0)), Some(true));
        // A saddle at the isovalue is above: both ends are joined by a single point.
        assert_eq!(tunnel(&cell(3.0)), Some(true));
        assert_eq!(tunnel(&cell(3.0).map(|v| -v)), None);
    }
}
