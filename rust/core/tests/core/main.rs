//! Tests of the mathematics: members, weights, linearisation, solvers and the step as a whole.

mod bounds;
mod caution;
mod delay;
mod ensemble;
mod errors;
mod executor;
mod friction;
mod gp;
mod horizon_variance;
mod library;
mod mixture;
mod operating;
mod preview;
mod proximal;
mod qp;
mod residual;
mod shift;
mod solvers;
mod step;
mod weights;
