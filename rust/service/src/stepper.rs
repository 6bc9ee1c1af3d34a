//! What the workers run.

use egp_wire::{Ready, Status, WireError};

/// The reply to a request, encoded.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Answer {
    /// How the solver ended, for the metrics.
    pub status: Status,
    /// Bytes of an `egp.v1.StepReply`.
    pub payload: Vec<u8>,
}

/// Turns requests into replies; in production an [`crate::Engine`].
pub trait Stepper: Send + Sync + 'static {
    /// Memory of one worker.
    type Workspace: Send;

    /// What a client must know to make requests.
    fn describe(&self) -> Ready;

    /// Memory for one more worker.
    ///
    /// # Errors
    /// [`WireError`] when it cannot be made.
    fn workspace(&self) -> Result<Self::Workspace, WireError>;

    /// Answers one request.
    ///
    /// # Errors
    /// [`WireError`] as it is told to the client.
    fn step(&self, workspace: &mut Self::Workspace, request: &[u8]) -> Result<Answer, WireError>;
}
