//! The memory map, which only the caller can know to be sound.

#![expect(
    unsafe_code,
    reason = "a map changes under our feet when another process writes to the file"
)]

use super::bytes::Bytes;
use super::{RawFile, RawSpec};
use crate::budget::Budget;
use crate::error::{Error, ErrorKind, Result};
use std::path::Path;

impl RawFile {
    /// Opens `path` as a memory map: no copy and no buffer, the same samples as [`open`](Self::open).
    ///
    /// A gain of a few microseconds per block where the data is in memory already; reads are as
    /// fast or faster where it is not.
    ///
    /// # Safety
    /// As long as this field lives nobody, in this process or another, writes to the file, replaces
    /// its content or cuts it. Changed bytes under a map are undefined behaviour, and a page that
    /// was cut off or cannot be read from the disk ends the process by a signal. Only the caller
    /// knows whether that is so; [`open`](Self::open) makes an error of all of it.
    ///
    /// # Errors
    /// As [`open`](Self::open); also [`ErrorKind::LimitExceeded`] where the address space is too
    /// small.
    ///
    /// # Memory
    /// Pages of the file that are in memory count as resident of this process but are not under the
    /// budget: the system takes them back when it needs them.
    pub unsafe fn open_mapped(path: &Path, spec: &RawSpec, budget: &Budget) -> Result<Self> {
        let file = Self::open_checked(path, spec)?;
        let length = usize::try_from(spec.end(path)? - spec.offset).map_err(|_| {
            Error::new(
                ErrorKind::LimitExceeded,
                format!("{}: too large to map: read it instead", path.display()),
            )
        })?;
        // SAFETY: the map is only read, ends inside the file (checked just now), and the caller
        // promises that nobody changes the file while it lives.
        let map = unsafe {
            memmap2::MmapOptions::new()
                .offset(spec.offset)
                .len(length)
                .map(&file)
        }
        .map_err(|e| Error::io(path, "mapping raw samples", e))?;
        let start = spec.offset;
        Ok(Self::new(path, spec, budget, Bytes::Map { map, start }))
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{read, scratch_file, specs};
    use super::*;
    use crate::field::Field;
    use crate::lattice::Box3;

    #[test]
    fn mapped_and_read_give_the_same_bits() {
        for (spec, bytes) in specs() {
            let file = scratch_file(&bytes);
            let budget = Budget::mib(4);
            let plain = RawFile::open(file.path(), &spec, &budget).expect("opens");
            // SAFETY: nobody else knows the scratch file.
            let mapped = unsafe { RawFile::open_mapped(file.path(), &spec, &budget) };
            let mapped = mapped.expect("maps");
            plain.scan_ranges(&budget).expect("scans");
            mapped.scan_ranges(&budget).expect("scans");
            let domain = spec.grid.domain;
            let inner = Box3::new(domain.min.map(|v| v + 1), domain.max);
            for region in [domain, inner] {
                let bits = |field| read(field, region).iter().map(|v| v.to_bits()).collect();
                let (a, b): (Vec<u32>, Vec<u32>) = (bits(&plain), bits(&mapped));
                assert!(a == b, "{spec:?} {region}");
                assert_eq!(
                    plain.range(region).expect("known"),
                    mapped.range(region).expect("known")
                );
            }
        }
    }

    #[test]
    fn a_short_file_is_refused_before_it_is_mapped() {
        for (spec, bytes) in specs() {
            let file = scratch_file(&bytes[..bytes.len() - 1]);
            let spec = RawSpec {
                more_follows: true,
                ..spec
            };
            // SAFETY: nobody else knows the scratch file.
            let refused = unsafe { RawFile::open_mapped(file.path(), &spec, &Budget::mib(1)) };
            assert_eq!(
                refused.expect_err("short").kind(),
                ErrorKind::Truncated,
                "{spec:?}"
            );
        }
    }
}
