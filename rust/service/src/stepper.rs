//! What the workers run.

use egp_wire::{Ready, Status, WireError};

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

    /// Answers one request: `reply` becomes the bytes of an `egp.v1.StepReply`. Returns how the solver ended, for the
    /// metrics.
    ///
    /// # Errors
    /// [`WireError`] as it is told to the client; `reply` then means nothing.
    fn step(
        &self,
        workspace: &mut Self::Workspace,
        request: &[u8],
        reply: &mut Vec<u8>,
    ) -> Result<Status, WireError>;
}
