//! Codecs 7 and 8 compiled for three kinds of processor; the same bytes.

#![expect(
    unsafe_code,
    reason = "calls into code compiled for instructions that were found present"
)]

#[cfg(target_arch = "x86_64")]
use super::super::rows::{Avx2, Avx512};
use super::super::rows::{Basic, Lanes};
use super::{Fit, Level, Moments};
use crate::sample::SampleType;

/// Calls `f::<S, E>(arguments)` for the type and the edge of a brick.
macro_rules! by_kind {
    ($f:ident($sample:expr, $edge:expr, $($argument:expr),*)) => {
        match $sample {
            SampleType::U8 => by_kind!(@ u8, $f($edge, $($argument),*)),
            SampleType::I8 => by_kind!(@ i8, $f($edge, $($argument),*)),
            SampleType::U16 => by_kind!(@ u16, $f($edge, $($argument),*)),
            _ => by_kind!(@ i16, $f($edge, $($argument),*)),
        }
    };
    (@ $type:ty, $f:ident($edge:expr, $($argument:expr),*)) => {
        match $edge {
            8 => super::$f::<$type, 8>($($argument),*),
            16 => super::$f::<$type, 16>($($argument),*),
            32 => super::$f::<$type, 32>($($argument),*),
            _ => super::$f::<$type, 64>($($argument),*),
        }
    };
}

#[inline(always)]
fn moments_all(sample: SampleType, edge: u32, raw: &[u8]) -> Moments {
    by_kind!(moments(sample, edge, raw))
}

#[inline(always)]
fn residuals_all(sample: SampleType, edge: u32, fit: Fit, raw: &[u8], out: &mut [[u8; 2]]) {
    by_kind!(residuals(sample, edge, fit, raw, out));
}

#[inline(always)]
fn restore_all(sample: SampleType, edge: u32, fit: Fit, words: &[[u8; 2]], out: &mut [u8]) {
    by_kind!(restore(sample, edge, fit, words, out));
}

#[inline(always)]
fn unpack_all<L: Lanes>(
    widths: &[u8],
    words: &[u8],
    out: &mut [[u8; 2]],
) -> Result<(), &'static str> {
    super::unpack::<L>(widths, words, out)
}

/// Defines a function for all levels.
macro_rules! levels {
    ($(fn $name:ident($($arg:ident: $type:ty),*) $(-> $out:ty)? = $portable:expr, $avx2:expr, $avx512:expr;)*) => {
        $(pub(super) fn $name(level: Level, $($arg: $type),*) $(-> $out)? {
            match level {
                Level::Portable => $portable,
                // SAFETY: a level exists only where the processor has its instructions.
                #[cfg(target_arch = "x86_64")]
                Level::Avx2 => unsafe { avx2::$name($($arg),*) },
                // SAFETY: as above.
                #[cfg(target_arch = "x86_64")]
                Level::Avx512 => unsafe { avx512::$name($($arg),*) },
            }
        })*

        #[cfg(target_arch = "x86_64")]
        mod avx2 {
            use super::*;
            $(#[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
            pub(super) fn $name($($arg: $type),*) $(-> $out)? { $avx2 })*
        }

        #[cfg(target_arch = "x86_64")]
        mod avx512 {
            use super::*;
            $(#[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl,avx2,bmi1,bmi2,lzcnt,popcnt")]
            pub(super) fn $name($($arg: $type),*) $(-> $out)? { $avx512 })*
        }
    };
}

levels! {
    fn moments(sample: SampleType, edge: u32, raw: &[u8]) -> Moments =
        moments_all(sample, edge, raw), moments_all(sample, edge, raw), moments_all(sample, edge, raw);
    fn residuals(sample: SampleType, edge: u32, fit: Fit, raw: &[u8], out: &mut [[u8; 2]]) =
        residuals_all(sample, edge, fit, raw, out), residuals_all(sample, edge, fit, raw, out),
        residuals_all(sample, edge, fit, raw, out);
    fn restore(sample: SampleType, edge: u32, fit: Fit, words: &[[u8; 2]], out: &mut [u8]) =
        restore_all(sample, edge, fit, words, out), restore_all(sample, edge, fit, words, out),
        restore_all(sample, edge, fit, words, out);
    fn unpack(widths: &[u8], words: &[u8], out: &mut [[u8; 2]]) -> Result<(), &'static str> =
        unpack_all::<Basic>(widths, words, out), unpack_all::<Avx2>(widths, words, out),
        unpack_all::<Avx512>(widths, words, out);
}
