//! What the operating system knows about this process and the disk.

use std::path::Path;

/// The rest of the line of /proc/self/status that starts with `name`, where there is such a file.
pub(crate) fn status_field(name: &str) -> Option<String> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|l| l.starts_with(name))?;
    Some(line[name.len()..].trim().to_string())
}

/// The most memory that was resident at one time, in bytes; unknown outside of Linux.
pub(crate) fn peak_resident_bytes() -> Option<u64> {
    let kib = status_field("VmHWM:")?;
    kib.split_whitespace()
        .next()?
        .parse::<u64>()
        .ok()
        .map(|v| v * 1024)
}

/// Starts the measurement of [`peak_resident_bytes`] again; false where the system does not allow.
pub(crate) fn reset_peak_resident() -> bool {
    std::fs::write("/proc/self/clear_refs", "5").is_ok()
}

/// Bytes that this user can still write in `folder`.
pub(crate) fn free_disk_bytes(folder: &Path) -> Option<u64> {
    let stat = rustix::fs::statvfs(folder).ok()?;
    Some(stat.f_bavail.saturating_mul(stat.f_frsize))
}

/// Ends this process when its parent, the process `parent`, ends, however it does.
pub(crate) fn die_with_parent(parent: i32) {
    #[cfg(target_os = "linux")]
    {
        use rustix::process::{Signal, getppid, set_parent_process_death_signal};
        let _ = set_parent_process_death_signal(Some(Signal::KILL));
        // It may have ended before we asked.
        if getppid().is_none_or(|p| p.as_raw_nonzero().get() != parent) {
            std::process::exit(1);
        }
    }
    #[cfg(not(target_os = "linux"))]
    let _ = parent;
}
