//! Which bytes an engine really computed for which request.

use std::collections::BTreeMap;
use std::hash::{DefaultHasher, Hasher as _};
use std::sync::{Arc, Mutex, PoisonError};

use egp_engine::{Engine, EngineWorkspace};
use egp_service::Handler;
use egp_wire::{Header, Ready, Status, WireError};

use crate::library::{Uptime, Uses};

/// The hash of some bytes.
pub(crate) fn hash(bytes: &[u8]) -> u64 {
    let mut hasher = DefaultHasher::new(); // its keys are constant
    hasher.write(bytes);
    hasher.finish()
}

/// Hash of each reply that an engine made, with those of its requests; requests that differ in their budget have the same
/// reply.
#[derive(Clone, Default)]
pub(crate) struct Ledger(Arc<Mutex<BTreeMap<u64, Vec<u64>>>>);

impl Ledger {
    fn note(&self, request: &[u8], reply: &[u8]) {
        let mut made = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let (requests, request) = (made.entry(hash(reply)).or_default(), hash(request));
        if !requests.contains(&request) {
            requests.push(request);
        }
    }

    /// The requests that this reply was made for; none if no engine made it.
    pub(crate) fn requests(&self, reply: &[u8]) -> Vec<u64> {
        let made = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        made.get(&hash(reply)).cloned().unwrap_or_default()
    }
}

/// An engine whose replies are noted.
pub(crate) struct NotedEngine {
    pub(crate) engine: Arc<Engine>,
    pub(crate) ledger: Ledger,
    pub(crate) uptime: Uptime,
    pub(crate) uses: Uses,
}

impl Handler for NotedEngine {
    type Workspace = EngineWorkspace;

    fn describe(&self) -> Ready {
        self.engine.describe()
    }

    fn workspace(&self) -> Result<EngineWorkspace, WireError> {
        self.engine.workspace()
    }

    fn step(
        &self,
        workspace: &mut EngineWorkspace,
        request: &[u8],
        reply: &mut Vec<u8>,
    ) -> Result<Status, WireError> {
        let status = self.engine.step(workspace, request, reply)?;
        let id = self.engine.library().id();
        let stated = Header::decode(request);
        // A reply of another library than the one that the request states is no reply to it.
        if stated.is_ok_and(|header| header.library == id) {
            self.ledger.note(request, reply);
        }
        self.uses.note(id, self.uptime.get());
        Ok(status)
    }
}
