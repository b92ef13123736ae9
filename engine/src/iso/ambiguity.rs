//! The asymptotic decider: which corners of an alternating face are joined across it.
//!
//! The bilinear interpolant of a face has one saddle, with value `(a c - b d) / (a + c - b - d)`
//! where `a, c` are the corners at or above the isovalue and `b, d` those below, the isovalue
//! taken off (Nielson and Hamann 1991). The denominator is positive, so the sign is that of
//! `a c - b d`. The comparison reads the same from both cells of the face: products commute, and
//! the pairs keep their places; and it is exact. A saddle at the isovalue counts as above, as a sample does.

use super::cube::face_corners;
use super::exact::determinant_sign;
use crate::sample::Inside;

/// The corners less the isovalue. NaN is outside, and as far outside as can be; infinities are as
/// far away as can be.
#[inline]
pub(crate) fn offsets<const N: usize>(values: &[f32; N], iso: f32, inside: Inside) -> [f64; N] {
    let unknown = match inside {
        Inside::Above => f64::from(f32::MIN),
        Inside::Below => f64::from(f32::MAX),
    };
    let mut out = [unknown; N];
    for (offset, &value) in out.iter_mut().zip(values) {
        if !value.is_nan() {
            *offset = f64::from(value.clamp(f32::MIN, f32::MAX)) - f64::from(iso);
        }
    }
    out
}

/// Bit per ambiguous face whose inside corners are joined, given the corners less the isovalue.
#[inline]
pub(crate) fn joined_faces(offsets: &[f64; 8], faces: u8, inside: Inside) -> u8 {
    let mut joined = 0;
    let mut left = faces;
    while left != 0 {
        let face = left.trailing_zeros() as usize;
        left &= left - 1;
        let ring = FACE_CORNERS[face].map(|corner| offsets[corner]);
        joined |= u8::from(is_joined(ring, inside)) << face;
    }
    joined
}

/// Whether the inside corners of an alternating face are joined across it, given its corners less the
/// isovalue, around it.
#[inline(always)]
pub(super) fn is_joined([p, q, r, s]: [f64; 4], inside: Inside) -> bool {
    let saddle = determinant_sign(p, r, q, s);
    // The pair at or above the isovalue is (p, r) or (q, s).
    let above = if p >= 0.0 { saddle >= 0 } else { saddle <= 0 };
    above == (inside == Inside::Above)
}

const FACE_CORNERS: [[usize; 4]; 6] = {
    let mut out = [[0; 4]; 6];
    let mut face = 0;
    while face < 6 {
        out[face] = face_corners(face);
        face += 1;
    }
    out
};

#[cfg(test)]
mod tests {
    use super::*;

    /// Corners of the face z = 0 in ring order from below are 2, 3, 1, 0 turned; set by coordinate.
    fn cell(v00: f32, v10: f32, v01: f32, v11: f32) -> [f32; 8] {
        [v00, v10, v01, v11, 0.0, 0.0, 0.0, 0.0]
    }

    fn joined_faces(values: &[f32; 8], faces: u8, iso: f32, inside: Inside) -> u8 {
        super::joined_faces(&offsets(values, iso, inside), faces, inside)
    }

    #[test]
    fn the_saddle_decides_and_ties_are_above() {
        const LOW_Z: u8 = 1 << 4;
        let strong = cell(3.0, -1.0, -1.0, 3.0);
        let weak = cell(1.0, -3.0, -3.0, 1.0);
        let tie = cell(2.0, -2.0, -2.0, 2.0);
        for (values, above) in [(strong, true), (weak, false), (tie, true)] {
            assert_eq!(
                joined_faces(&values, LOW_Z, 0.0, Inside::Above) == LOW_Z,
                above
            );
            assert_eq!(
                joined_faces(&values, LOW_Z, 0.0, Inside::Below) == LOW_Z,
                !above
            );
        }
        let infinite = cell(f32::INFINITY, f32::NAN, -1.0, 1.0);
        assert_eq!(joined_faces(&infinite, LOW_Z, 0.0, Inside::Above), LOW_Z);
    }
}
