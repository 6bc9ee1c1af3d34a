//! Variances and standard deviations of the transitions of a trajectory.

use crate::ocp::TransitionUncertainty;
use crate::preview::StageWeights;
use crate::vehicle::gp_input;
use crate::{
    Ensemble, Executor, GpInput, GpOutput, Input, Member, MixtureScratch, NY, State, StepReply,
};

/// Memory for the variances along a trajectory.
pub(super) struct Deviations {
    queries: Vec<GpInput>,
    variances: Vec<GpOutput>,
    scratch: MixtureScratch,
    uncertainties: Vec<TransitionUncertainty>,
    /// Variance of the residual at each stage; empty without one.
    pub residual: Vec<GpOutput>,
}

impl Deviations {
    pub fn new(horizon: usize) -> Self {
        Self {
            queries: Vec::with_capacity(horizon),
            variances: vec![GpOutput::zeros(); horizon],
            scratch: MixtureScratch::default(),
            uncertainties: Vec::with_capacity(horizon),
            residual: Vec::with_capacity(horizon),
        }
    }

    /// Computes the variances of the transitions that begin with these states and inputs, each at most 22 % too large, with
    /// that of the residual.
    fn compute<'a>(
        &mut self,
        ensembles: impl Fn(usize) -> Ensemble<'a>,
        transitions: impl Iterator<Item = (State, Input)>,
        executor: &dyn Executor,
    ) {
        self.queries.clear();
        self.queries
            .extend(transitions.map(|(x, u)| gp_input(&x, &u)));
        let (scratch, variances) = (&mut self.scratch, &mut self.variances);
        Ensemble::mixture_bounds(ensembles, &self.queries, scratch, variances, executor);
        for (variance, residual) in variances.iter_mut().zip(&self.residual) {
            *variance += residual;
        }
    }

    /// Writes the standard deviations of `[v_x, v_y, omega]` along the plan, given the state before, from the plan's
    /// transitions: each state with the input, in N and rad/s, that is applied from it on. Row 0, the measurement, is zero.
    pub fn write<'a>(
        &mut self,
        ensembles: impl Fn(usize) -> Ensemble<'a>,
        transitions: impl Iterator<Item = (State, Input)>,
        executor: &dyn Executor,
        reply: &mut StepReply,
    ) {
        self.compute(ensembles, transitions, executor);
        reply.sigma.extend([0.0; NY]);
        let std = (self.variances.iter()).flat_map(|v| <[f64; NY]>::from(v.map(f64::sqrt)));
        reply.sigma.extend(std);
    }

    /// What is uncertain about each transition of the operating trajectory: the ensemble's variance, and the effect of one
    /// standard deviation of the friction where `road` states it.
    pub fn uncertainties<'a>(
        &mut self,
        members: &[Member],
        stages: &StageWeights,
        ensembles: impl Fn(usize) -> Ensemble<'a>,
        road: &[[f64; 2]],
        transitions: impl Iterator<Item = (State, Input)>,
        executor: &dyn Executor,
    ) -> &[TransitionUncertainty] {
        self.compute(ensembles, transitions, executor);
        self.uncertainties.clear();
        let transitions = self.queries.iter().zip(&self.variances).enumerate();
        let uncertainties = transitions.map(|(t, (z, variance))| TransitionUncertainty {
            variance: *variance,
            friction: match road.get(t + 1) {
                Some([friction, std]) => stages.slope(members, *friction, z) * *std,
                None => GpOutput::zeros(),
            },
        });
        self.uncertainties.extend(uncertainties);
        &self.uncertainties
    }
}
