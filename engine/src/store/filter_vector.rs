//! The filters compiled for three kinds of processor; the same source, the same bytes.

#![expect(
    unsafe_code,
    reason = "calls into code compiled for instructions that were found present"
)]

use super::{Filter, Level, forward_all, inverse_all};

/// Width of a sample, whether it is f32, edge of the brick.
type Shape = (usize, bool, u32);

pub(super) fn forward(level: Level, filter: Filter, shape: Shape, raw: &[u8], planes: &mut [u8]) {
    match level {
        Level::Portable => forward_all(filter, shape, raw, planes),
        // SAFETY: a level exists only where the processor has its instructions.
        #[cfg(target_arch = "x86_64")]
        Level::Avx2 => unsafe { x86::forward_avx2(filter, shape, raw, planes) },
        // SAFETY: as above.
        #[cfg(target_arch = "x86_64")]
        Level::Avx512 => unsafe { x86::forward_avx512(filter, shape, raw, planes) },
    }
}

pub(super) fn inverse(
    level: Level,
    filter: Filter,
    float: bool,
    edge: u32,
    planes: &[&[u8]],
    raw: &mut [u8],
) {
    match level {
        Level::Portable => inverse_all(filter, float, edge, planes, raw),
        // SAFETY: a level exists only where the processor has its instructions.
        #[cfg(target_arch = "x86_64")]
        Level::Avx2 => unsafe { x86::inverse_avx2(filter, float, edge, planes, raw) },
        // SAFETY: as above.
        #[cfg(target_arch = "x86_64")]
        Level::Avx512 => unsafe { x86::inverse_avx512(filter, float, edge, planes, raw) },
    }
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    use super::{Filter, Shape, forward_all, inverse_all};

    #[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
    pub(super) fn forward_avx2(filter: Filter, shape: Shape, raw: &[u8], planes: &mut [u8]) {
        forward_all(filter, shape, raw, planes);
    }

    #[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl,avx2,bmi1,bmi2,lzcnt,popcnt")]
    pub(super) fn forward_avx512(filter: Filter, shape: Shape, raw: &[u8], planes: &mut [u8]) {
        forward_all(filter, shape, raw, planes);
    }

    #[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
    pub(super) fn inverse_avx2(
        filter: Filter,
        float: bool,
        edge: u32,
        planes: &[&[u8]],
        raw: &mut [u8],
    ) {
        inverse_all(filter, float, edge, planes, raw);
    }

    #[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl,avx2,bmi1,bmi2,lzcnt,popcnt")]
    pub(super) fn inverse_avx512(
        filter: Filter,
        float: bool,
        edge: u32,
        planes: &[&[u8]],
        raw: &mut [u8],
    ) {
        inverse_all(filter, float, edge, planes, raw);
    }
}
