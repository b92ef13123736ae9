//! Moves a scratch file to the end of the file that it belongs to.

use std::fs::File;
use std::io::Result;
use std::sync::Mutex;

/// Bytes that a thread moves at a time.
const CHUNK: u64 = 8 << 20;
/// More than two gain nothing: memory is the limit.
const THREADS_MAX: usize = 2;

/// Copies the `length` bytes of `scratch` to `file` from `offset` on, in the kernel where it can.
/// What was copied is given back to the file system chunk by chunk where it allows that, so that
/// the disk (or memory, on a file system in memory) holds the bytes once and not twice.
pub(crate) fn append(
    scratch: &File,
    length: u64,
    file: &File,
    offset: u64,
    threads: usize,
) -> Result<()> {
    // Holes would show; whole at once fails early on a full disk.
    file.set_len(offset + length)?;
    let chunks = Mutex::new((0..length).step_by(CHUNK as usize));
    let work = || -> Result<()> {
        loop {
            let next = chunks.lock().expect("no thread panicked").next();
            let Some(at) = next else {
                return Ok(());
            };
            let bytes = CHUNK.min(length - at);
            copy(scratch, at, file, offset + at, bytes)?;
            give_back(scratch, at, bytes);
        }
    };
    let others = threads.clamp(1, THREADS_MAX) - 1;
    std::thread::scope(|scope| {
        let others: Vec<_> = (0..others).map(|_| scope.spawn(work)).collect();
        let mut result = work();
        for other in others {
            result = result.and(other.join().expect("no thread panicked"));
        }
        result
    })
}

#[cfg(target_os = "linux")]
fn copy(from: &File, mut at: u64, to: &File, mut offset: u64, mut bytes: u64) -> Result<()> {
    use rustix::io::Errno;
    while bytes > 0 {
        let n = bytes.min(1 << 30) as usize;
        match rustix::fs::copy_file_range(from, Some(&mut at), to, Some(&mut offset), n) {
            Ok(0) => return Err(std::io::ErrorKind::UnexpectedEof.into()),
            Ok(n) => bytes -= n as u64,
            Err(Errno::INTR) => {}
            // Old kernels and some file systems cannot.
            Err(Errno::NOSYS | Errno::XDEV | Errno::INVAL | Errno::OPNOTSUPP | Errno::PERM) => {
                return copy_through_memory(from, at, to, offset, bytes);
            }
            Err(e) => return Err(e.into()),
        }
    }
    Ok(())
}

#[cfg(not(target_os = "linux"))]
use copy_through_memory as copy;

fn copy_through_memory(
    from: &File,
    mut at: u64,
    to: &File,
    mut offset: u64,
    mut bytes: u64,
) -> Result<()> {
    let mut buffer = vec![0; bytes.min(1 << 18) as usize];
    while bytes > 0 {
        let n = bytes.min(buffer.len() as u64) as usize;
        crate::aside::read_exact_at(from, &mut buffer[..n], at)?;
        crate::aside::write_all_at(to, &buffer[..n], offset)?;
        at += n as u64;
        offset += n as u64;
        bytes -= n as u64;
    }
    Ok(())
}

/// Frees the room of what was copied; that it cannot costs nothing but room.
fn give_back(file: &File, at: u64, bytes: u64) {
    #[cfg(target_os = "linux")]
    {
        use rustix::fs::FallocateFlags;
        let flags = FallocateFlags::PUNCH_HOLE | FallocateFlags::KEEP_SIZE;
        let _ = rustix::fs::fallocate(file, flags, at, bytes);
    }
    #[cfg(not(target_os = "linux"))]
    let _ = (file, at, bytes);
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::{Read, Seek, Write};

    #[test]
    fn both_ways_bring_every_byte() {
        let bytes: Vec<u8> = (0..3 * CHUNK + 12_345)
            .map(|i| ((i * i) >> 7) as u8)
            .collect();
        for (threads, in_kernel) in [(1, true), (2, true), (1, false)] {
            let mut scratch = tempfile::tempfile().expect("scratch");
            scratch.write_all(&bytes).expect("written");
            let mut file = tempfile::tempfile().expect("file");
            file.write_all(b"head").expect("written");
            let length = bytes.len() as u64;
            if in_kernel {
                append(&scratch, length, &file, 4, threads).expect("appended");
            } else {
                copy_through_memory(&scratch, 0, &file, 4, length).expect("appended");
            }
            let mut found = Vec::new();
            file.rewind().expect("rewound");
            file.read_to_end(&mut found).expect("read");
            assert!(found[..4] == *b"head" && found[4..] == bytes);
        }
    }
}
