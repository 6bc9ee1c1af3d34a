//! Health, readiness and metrics over HTTP, for orchestrators and Prometheus; no other file of this crate uses tiny_http.

use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::thread::{self, JoinHandle};

use tiny_http::{Header, Method, Request, Response};

use crate::intake::Shared;
use crate::query::Query;
use crate::server::StartError;

/// The encoding of [`crate::metrics::Metrics::text`].
const OPEN_METRICS: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";
const TEXT: &str = "text/plain; charset=utf-8";

/// An address that is listened on; connections wait until [`HttpListener::answer`] is called.
pub(crate) struct HttpListener(tiny_http::Server);

impl HttpListener {
    /// Listens on `address`.
    ///
    /// # Errors
    /// [`StartError::Http`] if the address is in use or not one of this machine.
    pub(crate) fn bind(address: SocketAddr) -> Result<Self, StartError> {
        tiny_http::Server::http(address)
            .map(Self)
            .map_err(|reason| StartError::Http {
                address,
                reason: reason.to_string(),
            })
    }

    /// Answers requests in a thread of its own.
    ///
    /// # Errors
    /// [`StartError::Thread`] if the system cannot start the thread.
    pub(crate) fn answer<Q: Query + Send + 'static>(
        self,
        shared: Arc<Shared<Q>>,
    ) -> Result<HttpEndpoint, StartError> {
        if let Some(address) = self.0.server_addr().to_ip() {
            tracing::info!(%address, "health, ready and metrics over HTTP");
        }
        let server = Arc::new(self.0);
        let incoming = server.clone();
        let thread = thread::Builder::new().name("egp-http".to_owned());
        let thread = thread.spawn(move || {
            for request in incoming.incoming_requests() {
                respond(&shared, request);
            }
        })?;
        Ok(HttpEndpoint {
            server,
            thread: Some(thread),
        })
    }
}

/// Answers requests over HTTP until it is dropped.
pub(crate) struct HttpEndpoint {
    server: Arc<tiny_http::Server>,
    thread: Option<JoinHandle<()>>,
}

impl Drop for HttpEndpoint {
    fn drop(&mut self) {
        self.server.unblock();
        if self
            .thread
            .take()
            .is_some_and(|thread| thread.join().is_err())
        {
            tracing::error!("the thread of HTTP ended by a panic");
        }
    }
}

fn respond<Q: Query>(shared: &Shared<Q>, request: Request) {
    let (status, content, text) = match request.method() {
        Method::Get | Method::Head => page(shared, request.url()),
        _ => (405, TEXT, "expected the method GET or HEAD\n".to_owned()),
    };
    let mut response = Response::from_string(text).with_status_code(status);
    if let Ok(header) = Header::from_bytes("Content-Type", content) {
        response = response.with_header(header);
    }
    if let Err(error) = request.respond(response) {
        tracing::debug!(%error, "answer over HTTP not sent");
    }
}

/// Status, content type and text of the page with this path.
fn page<Q: Query>(shared: &Shared<Q>, url: &str) -> (u16, &'static str, String) {
    match url.split('?').next() {
        Some("/health") => (200, TEXT, "ok\n".to_owned()),
        Some("/ready") if shared.draining.load(Ordering::Relaxed) => {
            (503, TEXT, "draining\n".to_owned())
        }
        Some("/ready") => (200, TEXT, "ready\n".to_owned()),
        Some("/metrics") => (200, OPEN_METRICS, shared.metrics.text(shared.queue.len())),
        _ => {
            let text = "no such page: expected /health, /ready or /metrics\n";
            (404, TEXT, text.to_owned())
        }
    }
}
