//! Connections: how many, how long they may take, and how they end.
//!
//! | limit | value |
//! |---|---|
//! | connections at one time; further ones wait to be accepted | 128 |
//! | time to send a whole request head, and between two requests | 5 s |
//! | time without taking a byte of an answer | 20 s |
//! | bytes of a request head | 16 KiB, 64 fields |
//! | bytes of a request body | 0 |
//! | time for running requests to end after a signal | 30 s |

use super::Site;
use super::answer::answer;
use brickmarch::CancelToken;
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::server::graceful::GracefulShutdown;
use std::io;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::Semaphore;
use tokio::time::{Sleep, sleep, timeout};

const CONNECTIONS_MAX: usize = 128;
const HEAD_TIME: Duration = Duration::from_secs(5);
const STALL_TIME: Duration = Duration::from_secs(20);
const HEAD_BYTES_MAX: usize = 16 << 10;
const FIELDS_MAX: usize = 64;
const GRACE: Duration = Duration::from_secs(30);
/// How often a signal is looked for.
const LOOK: Duration = Duration::from_millis(50);

/// Serves until `stop` is cancelled, then lets running requests end. Gives the number of connections
/// that did not.
pub(super) async fn serve(listener: TcpListener, site: Arc<Site>, stop: CancelToken) -> usize {
    let room = Arc::new(Semaphore::new(CONNECTIONS_MAX));
    let graceful = GracefulShutdown::new();
    while !stop.is_cancelled() {
        let Ok(Ok(place)) = timeout(LOOK, room.clone().acquire_owned()).await else {
            continue;
        };
        let stream = match timeout(LOOK, listener.accept()).await {
            Err(_) => continue,
            Ok(Ok((stream, _))) => stream,
            Ok(Err(_)) => {
                // Such as no file descriptor left: some will be free again.
                sleep(LOOK).await;
                continue;
            }
        };
        // Small answers are sent at once.
        let _ = stream.set_nodelay(true);
        let site = site.clone();
        let service = service_fn(move |request| answer(site.clone(), request));
        let connection = http1::Builder::new()
            .timer(TokioTimer::new())
            .header_read_timeout(HEAD_TIME)
            .max_buf_size(HEAD_BYTES_MAX)
            .max_headers(FIELDS_MAX)
            .serve_connection(TokioIo::new(Patient::new(stream)), service);
        let connection = graceful.watch(connection);
        tokio::spawn(async move {
            // What goes wrong on a connection ends that connection, and concerns nobody else.
            let _ = connection.await;
            drop(place);
        });
    }
    drop(listener);
    match timeout(GRACE, graceful.shutdown()).await {
        Ok(()) => 0,
        Err(_) => CONNECTIONS_MAX - room.available_permits(),
    }
}

/// A socket that fails when the other side takes nothing for too long.
struct Patient {
    stream: TcpStream,
    waiting: Option<Pin<Box<Sleep>>>,
}

impl Patient {
    fn new(stream: TcpStream) -> Patient {
        Patient {
            stream,
            waiting: None,
        }
    }

    /// Turns waiting for too long into an error.
    fn bounded<T>(
        &mut self,
        written: Poll<io::Result<T>>,
        context: &mut Context<'_>,
    ) -> Poll<io::Result<T>> {
        if written.is_ready() {
            self.waiting = None;
            return written;
        }
        let waiting = self
            .waiting
            .get_or_insert_with(|| Box::pin(sleep(STALL_TIME)));
        match waiting.as_mut().poll(context) {
            Poll::Ready(()) => Poll::Ready(Err(io::ErrorKind::TimedOut.into())),
            Poll::Pending => Poll::Pending,
        }
    }
}

impl AsyncRead for Patient {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_read(context, buffer)
    }
}

impl AsyncWrite for Patient {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        let written = Pin::new(&mut self.stream).poll_write(context, bytes);
        self.bounded(written, context)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        slices: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        let written = Pin::new(&mut self.stream).poll_write_vectored(context, slices);
        self.bounded(written, context)
    }

    fn is_write_vectored(&self) -> bool {
        true
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(context)
    }
}
