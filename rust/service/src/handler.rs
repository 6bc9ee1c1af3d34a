//! The interface by which a worker answers a request.

use egp_engine::{Engine, EngineWorkspace};
use egp_wire::{Ready, Status, WireError};

/// Turns the bytes of a request into those of a reply; in production an [`Engine`].
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
