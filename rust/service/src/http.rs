//! Health, readiness and metrics over HTTP, for orchestrators and Prometheus; no other file of this crate uses hyper.
//!
//! Each connection has one request, whose body is not read. It is closed after [`PATIENCE`], or if [`CONNECTIONS`] newer ones
//! came, so that clients that stop in the middle do not keep others waiting.

use std::collections::VecDeque;
use std::convert::Infallible;
use std::io;
use std::net::{SocketAddr, TcpListener};
use std::sync::Arc;
use std::time::Duration;

use http_body_util::Full;
use hyper::body::{Bytes, Incoming};
use hyper::header::{ALLOW, CONTENT_TYPE, HeaderValue};
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper::{Method, Request, Response, StatusCode};
use hyper_util::rt::TokioIo;
use tokio::net::TcpStream;
use tokio::runtime::{Builder, Runtime};
use tokio::sync::oneshot;
use tokio::task::AbortHandle;
use tokio::time;

use crate::background::Background;
use crate::start_error::StartError;

/// How long a connection may last.
const PATIENCE: Duration = Duration::from_secs(2);

/// Longest request line with its headers, bytes. hyper's default is 400 kB for each connection.
const LONGEST_HEAD: usize = 16 * 1024;

/// Connections at a time; a further one closes the oldest.
const CONNECTIONS: usize = 256;

/// Time for which no connection is accepted after the system failed to accept one, for instance because no descriptor is free.
const PAUSE: Duration = Duration::from_millis(100);

/// The encoding of [`crate::metrics::Metrics::text`].
const OPEN_METRICS: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";
const TEXT: &str = "text/plain; charset=utf-8";

/// An address that is listened on; connections wait until [`HttpListener::answer`] is called.
pub(crate) struct HttpListener(TcpListener);

impl HttpListener {
    /// Listens on `address`.
    ///
    /// # Errors
    /// [`StartError::Http`] if the address is in use or not one of this machine.
    pub(crate) fn bind(address: SocketAddr) -> Result<Self, StartError> {
        TcpListener::bind(address)
            .map(Self)
            .map_err(|reason| unusable(address, &reason))
    }

    /// Checks that the host of `address` is one of this machine; its port may be in use.
    ///
    /// # Errors
    /// [`StartError::Http`].
    pub(crate) fn check(address: SocketAddr) -> Result<(), StartError> {
        let free = SocketAddr::new(address.ip(), 0);
        TcpListener::bind(free)
            .map(drop)
            .map_err(|reason| unusable(address, &reason))
    }

    /// Answers requests in a thread of its own with these pages.
    ///
    /// # Errors
    /// [`StartError::Thread`] if the system cannot start the thread.
    pub(crate) fn answer(self, pages: Arc<dyn Pages>) -> Result<HttpEndpoint, StartError> {
        if let Ok(address) = self.0.local_addr() {
            tracing::info!(%address, "health, ready and metrics over HTTP");
        }
        self.0.set_nonblocking(true)?;
        let runtime = Builder::new_current_thread()
            .enable_io()
            .enable_time()
            .build()?;
        let (stop, stopped) = oneshot::channel();
        let work = move || run(&runtime, self.0, pages, stopped);
        Ok(Background::start("egp-http", stop, work)?)
    }
}

fn unusable(address: SocketAddr, reason: &io::Error) -> StartError {
    StartError::Http {
        address,
        reason: reason.to_string(),
    }
}

/// Answers requests over HTTP until it is dropped.
pub(crate) type HttpEndpoint = Background<oneshot::Sender<()>>;

/// Answers requests until the sender of `stopped` is dropped; connections that are open then are closed.
fn run(
    runtime: &Runtime,
    listener: TcpListener,
    pages: Arc<dyn Pages>,
    stopped: oneshot::Receiver<()>,
) {
    runtime.block_on(async move {
        match tokio::net::TcpListener::from_std(listener) {
            Ok(listener) => {
                tokio::spawn(accept(listener, pages));
                // Nothing is ever sent: the channel closes.
                let _ = stopped.await;
            }
            Err(error) => tracing::error!(%error, "no answers over HTTP"),
        }
    });
}

async fn accept(listener: tokio::net::TcpListener, pages: Arc<dyn Pages>) {
    let mut open = VecDeque::<AbortHandle>::new();
    loop {
        match listener.accept().await {
            Ok((stream, _)) => {
                open.push_back(tokio::spawn(converse(stream, pages.clone())).abort_handle());
                close_beyond(CONNECTIONS, &mut open);
            }
            Err(error) => {
                tracing::debug!(%error, "connection for HTTP not accepted");
                time::sleep(PAUSE).await;
            }
        }
    }
}

/// Closes the oldest connection if there are more than `most` of those that have not ended.
fn close_beyond(most: usize, open: &mut VecDeque<AbortHandle>) {
    open.retain(|connection| !connection.is_finished());
    if open.len() > most
        && let Some(oldest) = open.pop_front()
    {
        oldest.abort();
    }
}

/// Answers the request of a connection.
async fn converse(stream: TcpStream, pages: Arc<dyn Pages>) {
    let answer = service_fn(move |request| {
        let response = respond(&*pages, &request);
        async move { Ok::<_, Infallible>(response) }
    });
    let answered = http1::Builder::new()
        .keep_alive(false)
        .max_buf_size(LONGEST_HEAD)
        .serve_connection(TokioIo::new(stream), answer);
    match time::timeout(PATIENCE, answered).await {
        Ok(Ok(())) => {}
        Ok(Err(error)) => tracing::debug!(%error, "answer over HTTP not sent"),
        Err(_) => tracing::debug!("a connection for HTTP lasted too long"),
    }
}

/// What the pages show.
pub(crate) trait Pages: Send + Sync + 'static {
    /// Why the service is not ready, in one word; none if it is.
    fn not_ready(&self) -> Option<&'static str>;

    /// The metrics as OpenMetrics text.
    fn metrics(&self) -> String;
}

fn respond(pages: &dyn Pages, request: &Request<Incoming>) -> Response<Full<Bytes>> {
    let answered = [Method::GET, Method::HEAD].contains(request.method());
    let (status, content, text) = if answered {
        page(pages, request.uri().path())
    } else {
        let text = "expected the method GET or HEAD\n";
        (StatusCode::METHOD_NOT_ALLOWED, TEXT, text.to_owned())
    };
    let mut response = Response::new(Full::from(text));
    *response.status_mut() = status;
    let headers = response.headers_mut();
    headers.insert(CONTENT_TYPE, HeaderValue::from_static(content));
    if !answered {
        headers.insert(ALLOW, HeaderValue::from_static("GET, HEAD"));
    }
    response
}

/// Status, content type and text of the page with this path.
fn page(pages: &dyn Pages, path: &str) -> (StatusCode, &'static str, String) {
    match path {
        "/health" => (StatusCode::OK, TEXT, "ok\n".to_owned()),
        "/ready" => match pages.not_ready() {
            Some(state) => (StatusCode::SERVICE_UNAVAILABLE, TEXT, format!("{state}\n")),
            None => (StatusCode::OK, TEXT, "ready\n".to_owned()),
        },
        "/metrics" => (StatusCode::OK, OPEN_METRICS, pages.metrics()),
        _ => {
            let text = "no such page: expected /health, /ready or /metrics\n";
            (StatusCode::NOT_FOUND, TEXT, text.to_owned())
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use std::future::pending;
    use std::io::{Read as _, Write as _};

    use tokio::task::JoinHandle;

    use super::*;

    struct Empty;

    impl Pages for Empty {
        fn not_ready(&self) -> Option<&'static str> {
            None
        }

        fn metrics(&self) -> String {
            String::new()
        }
    }

    #[test]
    fn a_head_has_at_most_sixteen_kilobytes() {
        let listener = HttpListener::bind(([127, 0, 0, 1], 0).into()).unwrap();
        let address = listener.0.local_addr().unwrap();
        let _endpoint = listener.answer(Arc::new(Empty)).unwrap();
        let answer = |head: &str| {
            let mut stream = std::net::TcpStream::connect(address).unwrap();
            stream.write_all(head.as_bytes()).unwrap();
            let mut status = [0; 12];
            stream.read_exact(&mut status).unwrap();
            String::from_utf8_lossy(&status).into_owned()
        };
        let begun = format!("GET /health HTTP/1.1\r\nx: {}", "a".repeat(LONGEST_HEAD));
        assert_eq!(
            answer(&format!("{}\r\n\r\n", &begun[..8_000])),
            "HTTP/1.1 200"
        );
        // Nothing is left to read when the server closes the connection, which could take the answer with it.
        assert_eq!(answer(&begun[..LONGEST_HEAD]), "HTTP/1.1 431");
    }

    #[test]
    fn connections_that_have_ended_close_no_other_one() {
        let runtime = Builder::new_current_thread().build().unwrap();
        runtime.block_on(async {
            let slow = tokio::spawn(pending::<()>());
            let mut open = VecDeque::from([slow.abort_handle()]);
            for _ in 0..10 {
                let quick = tokio::spawn(async {});
                open.push_back(quick.abort_handle());
                quick.await.unwrap();
                close_beyond(2, &mut open);
            }
            assert!(!slow.is_finished());
            let others = [0; 2].map(|_| tokio::spawn(pending::<()>()));
            open.extend(others.iter().map(JoinHandle::abort_handle));
            close_beyond(2, &mut open);
            assert!(slow.await.unwrap_err().is_cancelled());
            assert!(!others.iter().any(JoinHandle::is_finished));
        });
    }
}
