//! The interface by which a worker answers a request.

use egp_engine::{Engine, EngineWorkspace};
use egp_wire::{LibraryId, Ready, Status, WireError};

use crate::sync::Arc;

/// The file of a library that is served.
#[derive(Clone)]
pub struct LibraryContent {
    /// Its bytes, whose SHA-256 is the library's id.
    pub bytes: Arc<[u8]>,
    /// The signature beside it, if there is one.
    pub signature: Option<[u8; 64]>,
}

/// Turns the bytes of a request into those of a reply. An [`Engine`] does so with one library.
pub trait Handler: Send + Sync + 'static {
    /// Memory of one worker.
    type Workspace: Send;

    /// The properties of the service that a client needs to make requests.
    fn describe(&self) -> Ready;

    /// Memory for one more worker.
    ///
    /// # Errors
    /// [`WireError`] if it cannot be made.
    fn workspace(&self) -> Result<Self::Workspace, WireError>;

    /// Answers one request: `reply` becomes the bytes of an `egp.v1.StepReply`. Returns how the solver ended, which the
    /// metrics count.
    ///
    /// # Errors
    /// [`WireError`], which is sent to the client; the content of `reply` is then unspecified.
    fn step(
        &self,
        workspace: &mut Self::Workspace,
        request: &[u8],
        reply: &mut Vec<u8>,
    ) -> Result<Status, WireError>;

    /// The file of a library, for others who fetch it; none if it is not served, or was not loaded from a file.
    fn content(&self, _library: &LibraryId) -> Option<LibraryContent> {
        None
    }
}

impl Handler for Engine {
    type Workspace = EngineWorkspace;

    fn describe(&self) -> Ready {
        self.describe()
    }

    fn workspace(&self) -> Result<EngineWorkspace, WireError> {
        self.workspace()
    }

    fn step(
        &self,
        workspace: &mut EngineWorkspace,
        request: &[u8],
        reply: &mut Vec<u8>,
    ) -> Result<Status, WireError> {
        self.step(workspace, request, reply)
    }
}
