//! Random dense fields of the kinds that break meshers.

use super::rng::Rng;
use brickmarch::Box3;

/// Kinds of random content.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Content {
    /// Independent uniform values: every case of every cell, half of the faces ambiguous.
    Noise,
    /// Values averaged with their neighbours: long thin sheets.
    Smooth,
    /// Whole numbers around the isovalue, many of them equal to it.
    Bytes,
    /// Four values, so that saddles fall on the isovalue.
    Plateaus,
    /// Noise with NaN in it.
    Nan,
    /// Noise with both infinities and NaN in it.
    Infinite,
    /// Magnitudes over forty powers of two.
    Extreme,
}

impl Content {
    pub(crate) const ALL: [Content; 7] = [
        Content::Noise,
        Content::Smooth,
        Content::Bytes,
        Content::Plateaus,
        Content::Nan,
        Content::Infinite,
        Content::Extreme,
    ];

    /// The isovalue that is meant.
    pub(crate) fn iso(self) -> f32 {
        match self {
            Content::Bytes => 128.0,
            Content::Plateaus => 1.0,
            _ => 0.0,
        }
    }
}

/// A dense array of random content.
pub(crate) fn random(content: Content, domain: Box3, rng: &mut Rng) -> Vec<f32> {
    let n = domain.count() as usize;
    let mut values: Vec<f32> = (0..n).map(|_| one(content, rng)).collect();
    if content == Content::Smooth {
        for _ in 0..2 {
            blur(&mut values, domain.size().map(|s| s as usize));
        }
    }
    values
}

fn one(content: Content, rng: &mut Rng) -> f32 {
    match content {
        Content::Noise | Content::Smooth => rng.signed(),
        Content::Bytes => (126 + rng.below(5)) as f32,
        Content::Plateaus => rng.below(4) as f32 - 0.5 * rng.below(2) as f32,
        Content::Nan if rng.chance(6) => f32::NAN,
        Content::Infinite if rng.chance(4) => {
            rng.pick(&[f32::INFINITY, f32::NEG_INFINITY, f32::NAN])
        }
        Content::Nan | Content::Infinite => rng.signed(),
        Content::Extreme => rng.signed() * 2f32.powi(rng.between(-20, 21)),
    }
}

fn blur(values: &mut [f32], size: [usize; 3]) {
    let steps = [1, size[0], size[0] * size[1]];
    for axis in 0..3 {
        let old = values.to_vec();
        for (i, value) in values.iter_mut().enumerate() {
            let at = i / steps[axis] % size[axis];
            let low = if at > 0 { old[i - steps[axis]] } else { old[i] };
            let high = if at + 1 < size[axis] {
                old[i + steps[axis]]
            } else {
                old[i]
            };
            *value = 0.25 * low + 0.5 * old[i] + 0.25 * high;
        }
    }
}

/// Signed distance to a sphere, negative inside.
pub(crate) fn sphere(domain: Box3, centre: [f64; 3], radius: f64) -> Vec<f32> {
    sampled(domain, |p| {
        let d2: f64 = (0..3).map(|a| (p[a] - centre[a]).powi(2)).sum();
        d2.sqrt() - radius
    })
}

/// Samples of a function of the lattice point.
pub(crate) fn sampled(domain: Box3, f: impl Fn([f64; 3]) -> f64) -> Vec<f32> {
    let mut values = Vec::with_capacity(domain.count() as usize);
    for k in domain.min[2]..domain.max[2] {
        for j in domain.min[1]..domain.max[1] {
            for i in domain.min[0]..domain.max[0] {
                values.push(f([i, j, k].map(f64::from)) as f32);
            }
        }
    }
    values
}
