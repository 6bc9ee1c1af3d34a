//! Health, readiness and metrics over HTTP, for orchestrators and Prometheus; no other file of this crate uses hyper.
//!
//! Each connection has one request, whose body is not read, and is closed after [`PATIENCE`] at the latest, so that a client
//! that stops in the middle takes a place for this time only.

use std::convert::Infallible;
use std::io;
use std::net::{SocketAddr, TcpListener};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::thread::{self, JoinHandle};
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
use tokio::sync::{OwnedSemaphorePermit, Semaphore, oneshot};
use tokio::time;

use crate::intake::Shared;
use crate::query::Query;
use crate::server::StartError;

/// How long a connection may last.
const PATIENCE: Duration = Duration::from_secs(5);

/// Connections at a time; further ones wait.
const CONNECTIONS: usize = 32;

/// How long no connection is accepted after the system could not accept one, for instance for want of descriptors.
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

    /// Answers requests in a thread of its own.
    ///
    /// # Errors
    /// [`StartError::Thread`] if the system cannot start the thread.
    pub(crate) fn answer<Q: Query + Send + 'static>(
        self,
        shared: Arc<Shared<Q>>,
    ) -> Result<HttpEndpoint, StartError> {
        if let Ok(address) = self.0.local_addr() {
            tracing::info!(%address, "health, ready and metrics over HTTP");
        }
        self.0.set_nonblocking(true)?;
        let runtime = Builder::new_current_thread()
            .enable_io()
            .enable_time()
            .build()?;
        let (stop, stopped) = oneshot::channel();
        let thread = thread::Builder::new().name("egp-http".to_owned());
        let thread = thread.spawn(move || run(&runtime, self.0, shared, stopped))?;
        Ok(HttpEndpoint {
            stop: Some(stop),
            thread: Some(thread),
        })
    }
}

fn unusable(address: SocketAddr, reason: &io::Error) -> StartError {
    StartError::Http {
        address,
        reason: reason.to_string(),
    }
}

/// Answers requests over HTTP until it is dropped.
pub(crate) struct HttpEndpoint {
    stop: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Drop for HttpEndpoint {
    fn drop(&mut self) {
        drop(self.stop.take());
        if self
            .thread
            .take()
            .is_some_and(|thread| thread.join().is_err())
        {
            tracing::error!("the thread of HTTP ended by a panic");
        }
    }
}

/// Answers requests until the sender of `stopped` is dropped; connections that are open then are closed.
fn run<Q: Query + Send + 'static>(
    runtime: &Runtime,
    listener: TcpListener,
    shared: Arc<Shared<Q>>,
    stopped: oneshot::Receiver<()>,
) {
    runtime.block_on(async move {
        match tokio::net::TcpListener::from_std(listener) {
            Ok(listener) => {
                tokio::spawn(accept(listener, shared));
                // Nothing is ever sent: the channel closes.
                let _ = stopped.await;
            }
            Err(error) => tracing::error!(%error, "no answers over HTTP"),
        }
    });
}

async fn accept<Q: Query + Send + 'static>(
    listener: tokio::net::TcpListener,
    shared: Arc<Shared<Q>>,
) {
    let places = Arc::new(Semaphore::new(CONNECTIONS));
    while let Ok(place) = places.clone().acquire_owned().await {
        match listener.accept().await {
            Ok((stream, _)) => {
                tokio::spawn(converse(stream, shared.clone(), place));
            }
            Err(error) => {
                tracing::debug!(%error, "connection for HTTP not accepted");
                time::sleep(PAUSE).await;
            }
        }
    }
}

/// Answers the request of a connection, which has one of the places.
async fn converse<Q: Query + Send + 'static>(
    stream: TcpStream,
    shared: Arc<Shared<Q>>,
    _place: OwnedSemaphorePermit,
) {
    let answer = service_fn(move |request| {
        let response = respond(&shared, &request);
        async move { Ok::<_, Infallible>(response) }
    });
    let answered = http1::Builder::new()
        .keep_alive(false)
        .serve_connection(TokioIo::new(stream), answer);
    match time::timeout(PATIENCE, answered).await {
        Ok(Ok(())) => {}
        Ok(Err(error)) => tracing::debug!(%error, "answer over HTTP not sent"),
        Err(_) => tracing::debug!("a connection for HTTP lasted too long"),
    }
}

fn respond<Q: Query>(shared: &Shared<Q>, request: &Request<Incoming>) -> Response<Full<Bytes>> {
    let answered = [Method::GET, Method::HEAD].contains(request.method());
    let (status, content, text) = if answered {
        page(shared, request.uri().path())
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
fn page<Q: Query>(shared: &Shared<Q>, path: &str) -> (StatusCode, &'static str, String) {
    match path {
        "/health" => (StatusCode::OK, TEXT, "ok\n".to_owned()),
        "/ready" if shared.draining.load(Ordering::Relaxed) => (
            StatusCode::SERVICE_UNAVAILABLE,
            TEXT,
            "draining\n".to_owned(),
        ),
        "/ready" => (StatusCode::OK, TEXT, "ready\n".to_owned()),
        "/metrics" => {
            let text = shared.metrics.text(shared.queue.len());
            (StatusCode::OK, OPEN_METRICS, text)
        }
        _ => {
            let text = "no such page: expected /health, /ready or /metrics\n";
            (StatusCode::NOT_FOUND, TEXT, text.to_owned())
        }
    }
}
