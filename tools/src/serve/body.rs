//! Bodies of answers: whole, or part by part, each read only when the client has taken the one
//! before. A slow client so holds memory that is under permit, but no thread.

use brickmarch::{Box3, Permit};
use hyper::body::{Body, Bytes, Frame, SizeHint};
use std::fs::File;
use std::io::{self, Read};
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use tokio::task::JoinHandle;

/// Gives the parts of a body one after the other; works, so it is not for the thread that waits.
pub(super) trait Parts: Send {
    /// The next part, `None` at the end.
    fn next(&mut self) -> io::Result<Option<Bytes>>;
}

type Next = (io::Result<Option<Bytes>>, Box<dyn Parts>);

/// The body of an answer.
pub(super) struct Reply {
    left: u64,
    state: State,
}

enum State {
    Whole(Bytes),
    Idle(Box<dyn Parts>),
    Working(JoinHandle<Next>),
    Over,
}

impl Reply {
    /// Bytes that are in memory.
    pub(super) fn whole(bytes: impl Into<Bytes>) -> Reply {
        let bytes = bytes.into();
        Reply {
            left: bytes.len() as u64,
            state: State::Whole(bytes),
        }
    }

    /// `length` bytes in parts.
    pub(super) fn parts(length: u64, parts: Box<dyn Parts>) -> Reply {
        Reply {
            left: length,
            state: State::Idle(parts),
        }
    }

    /// Bytes still to be sent.
    pub(super) fn length(&self) -> u64 {
        self.left
    }
}

impl Body for Reply {
    type Data = Bytes;
    type Error = io::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<io::Result<Frame<Bytes>>>> {
        loop {
            match std::mem::replace(&mut self.state, State::Over) {
                State::Over => return Poll::Ready(None),
                State::Whole(bytes) => {
                    self.left = 0;
                    return Poll::Ready((!bytes.is_empty()).then(|| Ok(Frame::data(bytes))));
                }
                State::Idle(mut parts) => {
                    self.state = State::Working(tokio::task::spawn_blocking(move || {
                        let next = parts.next();
                        (next, parts)
                    }));
                }
                State::Working(mut work) => {
                    let Poll::Ready(done) = Pin::new(&mut work).poll(context) else {
                        self.state = State::Working(work);
                        return Poll::Pending;
                    };
                    let (next, parts) = match done {
                        Ok(done) => done,
                        Err(panicked) => return Poll::Ready(Some(Err(io::Error::other(panicked)))),
                    };
                    return Poll::Ready(match next {
                        Ok(Some(bytes)) => {
                            self.left = self.left.saturating_sub(bytes.len() as u64);
                            if self.left > 0 {
                                self.state = State::Idle(parts);
                            }
                            Some(Ok(Frame::data(bytes)))
                        }
                        Ok(None) => None,
                        Err(error) => Some(Err(error)),
                    });
                }
            }
        }
    }

    fn is_end_stream(&self) -> bool {
        self.left == 0
    }

    fn size_hint(&self) -> SizeHint {
        SizeHint::with_exact(self.left)
    }
}

/// Bytes whose memory is under a permit until they were sent.
pub(super) struct Held {
    pub(super) bytes: Vec<u8>,
    pub(super) permit: Arc<Permit>,
}

impl Held {
    pub(super) fn into_bytes(self) -> Bytes {
        Bytes::from_owner(self)
    }
}

impl AsRef<[u8]> for Held {
    fn as_ref(&self) -> &[u8] {
        // The permit ends with the bytes.
        let _ = &self.permit;
        &self.bytes
    }
}

/// Samples of a region.
pub(super) struct Region {
    pub(super) shown: Arc<super::shelf::Shown>,
    pub(super) header: Vec<u8>,
    pub(super) parts: Box<dyn Iterator<Item = Box3> + Send>,
    pub(super) permit: Arc<Permit>,
}

impl Parts for Region {
    fn next(&mut self) -> io::Result<Option<Bytes>> {
        let Some(part) = self.parts.next() else {
            return Ok(None);
        };
        let volume = &self.shown.volume;
        let mut bytes = std::mem::take(&mut self.header);
        let start = bytes.len();
        let samples = part.count() as usize * volume.spec().sample.bytes();
        bytes.resize(start + samples, 0);
        volume
            .read_raw(part, &mut bytes[start..])
            .map_err(io::Error::other)?;
        let permit = self.permit.clone();
        Ok(Some(Held { bytes, permit }.into_bytes()))
    }
}

/// Most bytes of a file that are in memory at one time.
pub(super) const FILE_PART: usize = 256 << 10;

/// The rest of a file.
pub(super) struct Rest {
    pub(super) file: File,
    pub(super) permit: Arc<Permit>,
}

impl Parts for Rest {
    fn next(&mut self) -> io::Result<Option<Bytes>> {
        let mut bytes = vec![0; FILE_PART];
        let count = self.file.read(&mut bytes)?;
        bytes.truncate(count);
        let permit = self.permit.clone();
        Ok((count > 0).then(|| Held { bytes, permit }.into_bytes()))
    }
}
