//! What the processor can do, asked once. Code that gains from newer instructions is compiled
//! several times and chosen by [`Level`]; all levels give the same bits.

use std::sync::LazyLock;

/// Instructions that hot loops make use of, in ascending order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Level {
    /// What every processor of the architecture has.
    Portable,
    /// AVX2, BMI, popcnt.
    #[cfg(target_arch = "x86_64")]
    Avx2,
    /// AVX-512 F, BW, DQ, VL and VPOPCNTDQ beside the former (Ice Lake, Zen 4 and later).
    #[cfg(target_arch = "x86_64")]
    Avx512,
}

static AVAILABLE: LazyLock<Vec<Level>> = LazyLock::new(|| {
    #[allow(unused_mut, reason = "pushed to on some architectures")]
    let mut levels = vec![Level::Portable];
    #[cfg(target_arch = "x86_64")]
    {
        let avx2 = is_x86_feature_detected!("avx2")
            && is_x86_feature_detected!("bmi1")
            && is_x86_feature_detected!("bmi2")
            && is_x86_feature_detected!("lzcnt")
            && is_x86_feature_detected!("popcnt");
        let avx512 = is_x86_feature_detected!("avx512f")
            && is_x86_feature_detected!("avx512bw")
            && is_x86_feature_detected!("avx512dq")
            && is_x86_feature_detected!("avx512vl")
            && is_x86_feature_detected!("avx512vpopcntdq");
        if avx2 {
            levels.push(Level::Avx2);
        }
        if avx2 && avx512 {
            levels.push(Level::Avx512);
        }
    }
    levels
});

impl Level {
    /// The best of this processor.
    pub(crate) fn detect() -> Self {
        Self::available().last().copied().unwrap_or(Level::Portable)
    }

    /// All that this processor has, slowest first.
    pub(crate) fn available() -> &'static [Level] {
        &AVAILABLE
    }
}
