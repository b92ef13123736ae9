//! Interpolation between lattice points: what each of the neighbours counts.

/// The value at `t` of the way from `a` to `b`. At 0 only `a` counts, whatever `b` is.
#[inline(always)]
fn between(a: f32, b: f32, t: f32) -> f32 {
    let mixed = a + (b - a) * t;
    if t == 0.0 { a } else { mixed }
}

/// Trilinear interpolation in a cell, in single precision: along x, then y, then z. A corner without
/// weight does not count, so that on a lattice plane only the samples of that plane do.
#[inline(always)]
pub(super) fn trilinear(c: [f32; 8], [x, y, z]: [f32; 3]) -> f32 {
    let low = between(between(c[0], c[1], x), between(c[2], c[3], x), y);
    let high = between(between(c[4], c[5], x), between(c[6], c[7], x), y);
    between(low, high, z)
}

/// Gradient of the trilinear interpolant in a cell, per index step.
pub(super) fn trilinear_gradient(c: [f32; 8], [x, y, z]: [f64; 3]) -> [f32; 3] {
    let c = c.map(f64::from);
    let mix = |a: f64, b: f64, t: f64| a + (b - a) * t;
    let slope = |step: usize, [p, q]: [usize; 2], [s, t]: [f64; 2]| {
        let d = |at: usize| c[at + step] - c[at];
        mix(mix(d(0), d(p), s), mix(d(q), d(p + q), s), t) as f32
    };
    [
        slope(1, [2, 4], [y, z]),
        slope(2, [1, 4], [x, z]),
        slope(4, [1, 2], [x, y]),
    ]
}

/// Weights of the four samples around `t` and their derivatives: the cubic through the middle two whose
/// slopes there are central differences (Catmull and Rom 1974).
pub(super) fn cubic(t: f64) -> ([f64; 4], [f64; 4]) {
    let (t2, t3) = (t * t, t * t * t);
    (
        [
            0.5 * (-t3 + 2.0 * t2 - t),
            0.5 * (3.0 * t3 - 5.0 * t2 + 2.0),
            0.5 * (-3.0 * t3 + 4.0 * t2 + t),
            0.5 * (t3 - t2),
        ],
        [
            0.5 * (-3.0 * t2 + 4.0 * t - 1.0),
            0.5 * (9.0 * t2 - 10.0 * t),
            0.5 * (-9.0 * t2 + 8.0 * t + 1.0),
            0.5 * (3.0 * t2 - 2.0 * t),
        ],
    )
}

/// Sum over 4 x 4 x 4 samples in double precision; samples without weight do not count.
pub(super) fn weigh(values: &[f32; 64], [x, y, z]: [&[f64; 4]; 3]) -> f64 {
    let mut sum = 0.0;
    for (n, &value) in values.iter().enumerate() {
        let weight = x[n % 4] * y[n / 4 % 4] * z[n / 16];
        if weight != 0.0 {
            sum += weight * f64::from(value);
        }
    }
    sum
}
