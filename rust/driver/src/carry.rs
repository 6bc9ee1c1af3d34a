//! What a client keeps from one step to the next, because the service keeps nothing.

use std::collections::VecDeque;

use egp_wire::{
    GpInput, GpOutput, Input, LibraryId, Predictions, ReferenceRow, Reply, Request, State, Status,
    WidthRow,
};

/// One measured transition and, once a reply brought them, the members' predictions of it.
#[derive(Clone, Debug)]
struct Transition {
    /// Sequence number of the first request that held it.
    born: u64,
    z: GpInput,
    y: GpOutput,
    f: Option<Vec<GpOutput>>,
}

#[derive(Clone, Debug)]
struct Plan {
    /// Sequence number of the request whose measured state is row 0.
    born: u64,
    x: Vec<State>,
    u: Vec<Input>,
}

/// The state of a vehicle between steps: history, weights, plan, and the input being applied.
///
/// Once per control period: [`request`](Self::request) with the measured state, [`accept`](Self::accept)
/// when a reply comes (late ones too), [`applied`](Self::applied) with what went to the actuators.
#[derive(Clone, Debug)]
pub struct Carry {
    library: LibraryId,
    capacity: usize,
    sequence: u64,
    history: VecDeque<Transition>,
    weights: Vec<f64>,
    /// The last request whose reply does not change the weights, because they were stated after it.
    stated: u64,
    plan: Option<Plan>,
    accepted: u64,
    u: Input,
    /// State and input at the start of the running period; empty before the first input.
    running: Option<(State, Input)>,
    x: Option<State>,
}

impl Carry {
    /// An empty carry for a library; `history` is K, the number of transitions to keep.
    pub fn new(library: LibraryId, history: usize) -> Self {
        Self {
            library,
            capacity: history,
            sequence: 0,
            history: VecDeque::new(),
            weights: Vec::new(),
            stated: 0,
            plan: None,
            accepted: 0,
            u: [0.0; 2],
            running: None,
            x: None,
        }
    }

    /// Library of the requests.
    pub fn library(&self) -> LibraryId {
        self.library
    }

    /// Sequence number of the last request; 0 before the first.
    pub fn sequence(&self) -> u64 {
        self.sequence
    }

    /// Weights of the newest reply; empty before the first.
    pub fn weights(&self) -> &[f64] {
        &self.weights
    }

    /// Lets the next request start from these weights; the service checks them. Replies to earlier requests leave them as they
    /// are.
    pub fn start_from(&mut self, weights: Vec<f64>) {
        (self.weights, self.stated) = (weights, self.sequence);
    }

    /// As [`start_from`](Self::start_from), for a caller that knows the surface: from now on requests carry no history,
    /// so that the service returns the weights as they are.
    pub fn hold_weights(&mut self, weights: Vec<f64>) {
        self.start_from(weights);
        self.capacity = 0;
        self.history.clear();
    }

    /// Notes the input that goes to the actuators for the period that now begins.
    pub fn applied(&mut self, u: Input) {
        self.u = u;
        self.running = self.x.map(|x| (x, u));
    }

    /// Opens a control period: adds the transition of the last one and makes the request.
    ///
    /// Call it exactly once a period, even when the request is not sent: the plan's age is counted in
    /// calls. `x` is the measured state, `reference` and `widths` begin at now, `budget_us` is the time
    /// the answer has.
    pub fn request(
        &mut self,
        x: State,
        reference: Vec<ReferenceRow>,
        widths: Vec<WidthRow>,
        budget_us: u32,
    ) -> Request {
        self.sequence += 1;
        match self.running.take() {
            Some((before, u)) => self.remember(before, u, x),
            // Without the period before, the rows of the history would not be consecutive.
            None => self.history.clear(),
        }
        self.x = Some(x);
        self.discard_expired_plan(reference.len().saturating_sub(1));
        let (plan_x, plan_u, plan_shift) =
            self.plan.as_ref().map_or_else(Default::default, |plan| {
                (plan.x.clone(), plan.u.clone(), self.age(plan.born))
            });
        Request {
            library: self.library,
            sequence: self.sequence,
            budget_us,
            x,
            u_prev: self.u,
            weights: self.weights.clone(),
            plan_x,
            plan_u,
            plan_shift,
            history_z: self.history.iter().map(|transition| transition.z).collect(),
            history_y: self.history.iter().map(|transition| transition.y).collect(),
            history_f: self.predictions(),
            reference,
            widths,
            want_sigma: false,
            road_friction: Vec::new(),
        }
    }

    /// Counts control periods in which no request was made, because the measured state was not known or the caller was
    /// held up. The history starts anew with the next request.
    pub fn skip(&mut self, periods: u64) {
        self.sequence += periods;
        self.forget_running();
    }

    /// Forgets the running period, whose transition is not known: the history starts anew with the next request.
    pub(crate) fn forget_running(&mut self) {
        self.running = None;
        self.x = None;
    }

    /// Takes over what a reply brings, which must answer a request of this carry. Returns whether it was newer than the last one
    /// taken.
    ///
    /// Weights, unless others were stated since the request, and predictions count whatever the solver's status; a plan comes only with
    /// [`Status::Solved`], and until then the previous one stays and ages.
    pub fn accept(&mut self, reply: &Reply) -> bool {
        if reply.sequence <= self.accepted {
            return false;
        }
        self.accepted = reply.sequence;
        if reply.sequence > self.stated {
            self.weights.clone_from(&reply.weights);
        }
        // The reply's rows are the request's history, newest first; transitions added since have none.
        let known = self
            .history
            .iter_mut()
            .filter(|transition| transition.born <= reply.sequence);
        for (transition, f) in known.zip(reply.history_f.rows()) {
            transition.f = Some(f.to_vec());
        }
        if reply.status == Status::Solved {
            self.plan = Some(Plan {
                born: reply.sequence,
                x: reply.plan_x.clone(),
                u: reply.plan_u.clone(),
            });
        }
        true
    }

    /// Discards history, weights and plan, for instance after the vehicle was moved. Sequence numbers go on, and the input
    /// that the actuators apply is kept.
    pub fn reset(&mut self) {
        *self = Self {
            sequence: self.sequence,
            accepted: self.sequence,
            u: self.u,
            ..Self::new(self.library, self.capacity)
        };
    }

    fn remember(&mut self, before: State, u: Input, after: State) {
        let [_, _, v_x, _, v_y, omega, delta] = before;
        let [_, _, v_x_after, _, v_y_after, omega_after, _] = after;
        self.history.push_front(Transition {
            born: self.sequence,
            z: [v_x, v_y, omega, delta, u[0], u[1]],
            y: [v_x_after - v_x, v_y_after - v_y, omega_after - omega],
            f: None,
        });
        self.history.truncate(self.capacity);
    }

    /// Predictions of the oldest rows, newest of them first, as far as they are known without a gap.
    fn predictions(&self) -> Predictions {
        let rows = || {
            self.history
                .iter()
                .map(|transition| transition.f.as_deref())
        };
        let members = rows().next_back().flatten().map_or(0, <[_]>::len);
        let known = rows()
            .rev()
            .take_while(|row| row.is_some_and(|row| row.len() == members));
        let unknown = rows().len() - known.count();
        let values = rows().skip(unknown).flatten().flatten().copied();
        Predictions::new(members, values.collect())
    }

    fn age(&self, born: u64) -> u32 {
        u32::try_from(self.sequence - born).unwrap_or(u32::MAX)
    }

    /// Discards the plan if it has no input for this period, or another horizon.
    fn discard_expired_plan(&mut self, horizon: usize) {
        let age = self.plan.as_ref().map(|plan| self.age(plan.born) as usize);
        let fits = self
            .plan
            .as_ref()
            .is_some_and(|plan| plan.u.len() == horizon);
        if !fits || age.is_some_and(|age| age >= horizon) {
            self.plan = None;
        }
    }
}
