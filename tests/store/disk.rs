//! A disk that a test owns: it records every call, and can fail at the k-th.

use brickmarch::store::Storage;
use std::io;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Bytes that a device writes whole or tears.
pub(crate) const SECTOR: usize = 512;
/// Bytes that a device may lose together.
pub(crate) const BLOCK: usize = 4096;

/// What happened to the disk, in order.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Op {
    Write {
        offset: u64,
        bytes: Vec<u8>,
    },
    SetLen(u64),
    Sync,
    /// A commit that leads to this state was asked for.
    Begun(usize),
    /// The commit that leads to this state was reported as done.
    Acked(usize),
}

/// How a call fails.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Fault {
    NoSpace,
    Io,
    Interrupted,
    /// Half of the bytes are read or written, then an error.
    Short,
    /// A sync fails, and any part of what was not synced is gone, unnoticed by later syncs.
    Sync,
}

impl Fault {
    pub(crate) const ALL: [Fault; 5] = [
        Fault::NoSpace,
        Fault::Io,
        Fault::Interrupted,
        Fault::Short,
        Fault::Sync,
    ];

    fn error(self) -> io::Error {
        match self {
            Fault::NoSpace => io::ErrorKind::StorageFull.into(),
            Fault::Interrupted => io::ErrorKind::Interrupted.into(),
            Fault::Short => io::ErrorKind::WriteZero.into(),
            Fault::Io | Fault::Sync => io::Error::from_raw_os_error(5),
        }
    }
}

/// The plan of what fails.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Plan {
    /// Number of the call that fails, from 0, and how. `Fault::Sync` counts syncs only.
    pub(crate) at: Option<(u64, Fault)>,
    /// Every later call that could fail the same way fails too.
    pub(crate) stays: bool,
    /// The disk holds no more bytes.
    pub(crate) capacity: Option<u64>,
}

#[derive(Debug, Default)]
struct State {
    image: Vec<u8>,
    /// What survives whatever happens: the image at the last sync.
    synced: Vec<u8>,
    ops: Vec<Op>,
    calls: u64,
    syncs: u64,
    plan: Plan,
    /// What a failed sync loses: all, every second sector, all behind the superblocks, nothing.
    loss: u64,
    recording: bool,
    failed: u64,
}

/// The disk.
#[derive(Debug)]
pub(crate) struct Disk(Mutex<State>);

impl Disk {
    /// A disk that holds `image`, and records from now on.
    pub(crate) fn new(image: Vec<u8>) -> Self {
        Self(Mutex::new(State {
            synced: image.clone(),
            image,
            recording: true,
            ..State::default()
        }))
    }

    /// A disk that fails.
    pub(crate) fn failing(image: Vec<u8>, plan: Plan, loss: u64) -> Self {
        let disk = Self::new(image);
        {
            let mut state = disk.state();
            (state.plan, state.loss, state.recording) = (plan, loss, false);
        }
        disk
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(crate) fn mark(&self, op: Op) {
        self.state().ops.push(op);
    }

    /// The commit that was asked for and not yet reported as done.
    pub(crate) fn in_flight(&self) -> Option<usize> {
        let state = self.state();
        let last = state.ops.iter().rev().find_map(|op| match op {
            Op::Begun(n) => Some(Some(*n)),
            Op::Acked(_) => Some(None),
            _ => None,
        });
        last.flatten()
    }

    /// What happened so far.
    pub(crate) fn take_ops(&self) -> Vec<Op> {
        std::mem::take(&mut self.state().ops)
    }

    pub(crate) fn image(&self) -> Vec<u8> {
        self.state().image.clone()
    }

    /// What a loss of power leaves at least.
    pub(crate) fn synced(&self) -> Vec<u8> {
        self.state().synced.clone()
    }

    pub(crate) fn calls(&self) -> (u64, u64) {
        let state = self.state();
        (state.calls, state.syncs)
    }

    /// Calls that failed.
    pub(crate) fn failed(&self) -> u64 {
        self.state().failed
    }

    /// A writer elsewhere has made this of it.
    pub(crate) fn becomes(&self, image: Vec<u8>) {
        let mut state = self.state();
        state.synced.clone_from(&image);
        state.image = image;
    }

    /// From now on nothing fails.
    pub(crate) fn heal(&self) {
        self.state().plan = Plan::default();
    }
}

impl State {
    /// Counts a call; the fault when it is the one that fails.
    fn call(&mut self, kinds: &[Fault]) -> Option<Fault> {
        let n = self.calls;
        self.calls += 1;
        let (at, fault) = self.plan.at?;
        let hit = fault != Fault::Sync
            && kinds.contains(&fault)
            && (n == at || self.plan.stays && n > at);
        self.failed += u64::from(hit);
        hit.then_some(fault)
    }

    fn put(&mut self, bytes: &[u8], offset: usize) {
        let end = offset + bytes.len();
        if self.image.len() < end {
            self.image.resize(end, 0);
        }
        self.image[offset..end].copy_from_slice(bytes);
    }

    /// A failed sync: the kernel drops dirty pages, some of which had reached the disk.
    fn forget_unsynced(&mut self) {
        let (kind, odd) = (self.loss % 4, (self.loss / 4) as usize);
        if kind == 0 {
            let length = self.synced.len();
            self.image.resize(length, 0);
        }
        for (n, sector) in self.image.chunks_mut(SECTOR).enumerate() {
            let start = n * SECTOR;
            let lost = match kind {
                0 => true,
                1 => (n + odd).is_multiple_of(2),
                2 => start >= 3 * BLOCK + odd * SECTOR,
                _ => false,
            };
            if lost {
                for (i, byte) in sector.iter_mut().enumerate() {
                    *byte = self.synced.get(start + i).copied().unwrap_or(0);
                }
            }
        }
        self.synced.clone_from(&self.image);
    }
}

impl Storage for Disk {
    fn read_at(&self, buffer: &mut [u8], offset: u64) -> io::Result<()> {
        let mut state = self.state();
        let fault = state.call(&[Fault::Io, Fault::Interrupted, Fault::Short]);
        let source = usize::try_from(offset)
            .ok()
            .and_then(|start| state.image.get(start..start.checked_add(buffer.len())?));
        let source = source.ok_or(io::ErrorKind::UnexpectedEof)?;
        match fault {
            None => buffer.copy_from_slice(source),
            Some(fault) => {
                let half = buffer.len() / 2;
                buffer[..half].copy_from_slice(&source[..half]);
                return Err(fault.error());
            }
        }
        Ok(())
    }

    fn write_at(&self, bytes: &[u8], offset: u64) -> io::Result<()> {
        let mut state = self.state();
        let mut fault = state.call(&[Fault::NoSpace, Fault::Io, Fault::Interrupted, Fault::Short]);
        let offset = usize::try_from(offset).map_err(|_| io::ErrorKind::StorageFull)?;
        let mut part = bytes;
        if let Some(capacity) = state.plan.capacity {
            let room = (capacity as usize).saturating_sub(offset);
            if room < bytes.len() {
                part = &bytes[..room];
                fault = Some(Fault::NoSpace);
                state.failed += 1;
            }
        }
        if fault.is_some() && part.len() == bytes.len() {
            part = &bytes[..bytes.len() / 2];
        }
        state.put(part, offset);
        if state.recording {
            state.ops.push(Op::Write {
                offset: offset as u64,
                bytes: part.to_vec(),
            });
        }
        fault.map_or(Ok(()), |f| Err(f.error()))
    }

    fn len(&self) -> io::Result<u64> {
        let mut state = self.state();
        match state.call(&[Fault::Io, Fault::Interrupted]) {
            Some(fault) => Err(fault.error()),
            None => Ok(state.image.len() as u64),
        }
    }

    fn set_len(&self, length: u64) -> io::Result<()> {
        let mut state = self.state();
        if let Some(fault) = state.call(&[Fault::NoSpace, Fault::Io, Fault::Interrupted]) {
            return Err(fault.error());
        }
        state.image.resize(length as usize, 0);
        if state.recording {
            state.ops.push(Op::SetLen(length));
        }
        Ok(())
    }

    fn sync(&self) -> io::Result<()> {
        let mut state = self.state();
        let fault = state.call(&[Fault::NoSpace, Fault::Io, Fault::Interrupted]);
        let n = state.syncs;
        state.syncs += 1;
        let planned = state
            .plan
            .at
            .is_some_and(|(at, f)| f == Fault::Sync && (n == at || state.plan.stays && n > at));
        if let Some(fault) = fault.or(planned.then_some(Fault::Sync)) {
            state.failed += u64::from(planned);
            state.forget_unsynced();
            return Err(fault.error());
        }
        if state.recording {
            state.ops.push(Op::Sync);
        } else {
            let State { image, synced, .. } = &mut *state;
            synced.clone_from(image);
        }
        Ok(())
    }

    fn lock(&self) -> io::Result<bool> {
        Err(io::ErrorKind::Unsupported.into())
    }
}
