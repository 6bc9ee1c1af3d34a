//! Random driving problems: a linearised car on a winding road, and the problems of consecutive steps.

use egp_core::qp::{MAX_SOFT, OcpQp, OcpSolution, Penalty, SoftRow, Stage};
use egp_core::{Input, NU, State};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

const DT: f64 = 0.05;
const SLEW: [f64; NU] = [3.0, 0.4];

/// A car on a road with occasional bends. A tenth of the drives start far outside the soft bounds, and a tenth with an
/// applied input outside the hard bounds.
pub struct Drive {
    rng: ChaCha8Rng,
    v: f64,
    bend: f64,
    damping: f64,
    stiffness: f64,
    /// Position and heading of the current end of the road.
    end: [f64; 3],
}

impl Drive {
    /// The drive of `seed`; the same seed gives the same drive.
    pub fn new(seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut unit = || 2.0 * rng.random::<f64>() - 1.0;
        let v = 14.0 + 11.0 * unit();
        let (heading, bend) = (3.1 * unit(), 0.5 * unit() * (8.0 / v).min(1.0));
        let (damping, stiffness) = (0.2 + 0.15 * unit(), 3.0 + unit());
        Self {
            rng,
            v,
            bend,
            damping,
            stiffness,
            end: [0.0, 0.0, heading],
        }
    }

    /// Uniform in `[-1, 1)`.
    fn unit(&mut self) -> f64 {
        2.0 * self.rng.random::<f64>() - 1.0
    }

    fn chance(&mut self, probability: f64) -> bool {
        self.rng.random::<f64>() < probability
    }

    /// The first problem of the drive.
    pub fn problem(&mut self, horizon: usize) -> OcpQp {
        let wild = if self.chance(0.1) { 5.0 } else { 1.0 };
        let reach = if self.chance(0.1) { 2.0 } else { 0.9 };
        let mut qp = OcpQp::new(horizon, MAX_SOFT);
        qp.r = Input::new(0.05, 2.0);
        qp.r_d = Input::new(0.05, 5.0);
        qp.penalty = [Penalty {
            linear: 200.0,
            quadratic: 2000.0,
        }; MAX_SOFT];
        qp.x0 = State::from([
            0.5 * self.unit(),
            1.5 * wild * self.unit(),
            self.v + 2.0 * wild * self.unit(),
            self.end[2] + 0.2 * wild * self.unit(),
            wild * self.unit(),
            0.5 * wild * self.unit(),
            0.2 * wild * self.unit(),
        ]);
        qp.u_prev = Input::new(5.0 * reach * self.unit(), 0.4 * reach * self.unit());
        for t in 0..horizon {
            qp.stages_mut()[t] = self.stage();
        }
        finish(&mut qp);
        qp
    }

    /// The problem one period after `qp`, whose solution was applied with a little noise: the road continues and the
    /// dynamics are linearised again.
    pub fn successor(&mut self, qp: &mut OcpQp, solution: &OcpSolution) {
        if self.chance(0.05) {
            self.bend = 0.5 * self.unit() * (8.0 / self.v).min(1.0);
        }
        let noise = [0.01, 0.01, 0.03, 0.003, 0.02, 0.02, 0.001];
        qp.x0 = solution.x[1] + State::from(noise.map(|n| n * self.unit()));
        qp.u_prev = solution.u[0];
        let horizon = qp.horizon();
        let last = qp.stages()[horizon - 1].q;
        qp.stages_mut()[horizon - 1].q = last * 0.5; // no longer the terminal weight
        qp.stages_mut().rotate_left(1);
        for stage in &mut qp.stages_mut()[..horizon - 1] {
            for (i, j) in [(2, 4), (2, 5), (4, 4), (4, 5), (5, 4), (5, 5)] {
                stage.a[(i, j)] += 0.004 * self.unit();
            }
            stage.c[4] += 0.002 * self.unit();
            stage.c[5] += 0.002 * self.unit();
        }
        qp.stages_mut()[horizon - 1] = self.stage();
        finish(qp);
    }

    /// The next stage along the road.
    fn stage(&mut self) -> Stage {
        let mut stage = OcpQp::new(1, MAX_SOFT).stages()[0].clone();
        let v = self.v;
        let [x, y, psi] = self.end;
        let (sin, cos) = psi.sin_cos();
        stage.a = nalgebra::SMatrix::identity();
        stage.a[(0, 2)] = DT * cos;
        stage.a[(0, 3)] = -DT * v * sin;
        stage.a[(0, 4)] = -DT * sin;
        stage.a[(1, 2)] = DT * sin;
        stage.a[(1, 3)] = DT * v * cos;
        stage.a[(1, 4)] = DT * cos;
        stage.a[(0, 5)] = 0.5 * DT * stage.a[(0, 3)];
        stage.a[(1, 5)] = 0.5 * DT * stage.a[(1, 3)];
        stage.a[(2, 2)] = 0.99;
        stage.a[(2, 4)] = 0.05 * self.unit();
        stage.a[(2, 5)] = 0.05 * self.unit();
        stage.a[(3, 5)] = DT;
        stage.a[(4, 4)] = 1.0 - self.damping;
        stage.a[(4, 5)] = -DT * v * 0.6 * (1.0 + 0.2 * self.unit());
        stage.a[(4, 6)] = self.stiffness;
        stage.a[(5, 4)] = 0.1 * self.unit();
        stage.a[(5, 5)] = 1.0 - self.damping + 0.05 * self.unit();
        stage.a[(5, 6)] = 0.7 * self.stiffness;
        stage.b = nalgebra::SMatrix::zeros();
        stage.b[(2, 0)] = DT;
        stage.b[(4, 1)] = 0.05;
        stage.b[(5, 1)] = 0.05;
        stage.b[(6, 1)] = DT;
        // This makes the kinematics exact at the reference.
        stage.c = State::from([
            DT * v * psi * sin,
            -DT * v * psi * cos,
            0.01 * v,
            0.0,
            0.02 * self.unit(),
            0.02 * self.unit(),
            0.0,
        ]);
        let (x, y, psi) = (x + DT * v * cos, y + DT * v * sin, psi + DT * self.bend);
        self.end = [x, y, psi];
        let (sin, cos) = psi.sin_cos();
        let (lon, lat) = (10.0, 20.0);
        stage.q = nalgebra::SMatrix::zeros();
        stage.q[(0, 0)] = lon * cos * cos + lat * sin * sin;
        stage.q[(0, 1)] = (lon - lat) * sin * cos;
        stage.q[(1, 0)] = stage.q[(0, 1)];
        stage.q[(1, 1)] = lon * sin * sin + lat * cos * cos;
        stage.q[(2, 2)] = 2.0;
        stage.q[(3, 3)] = 10.0;
        stage.reference = State::from([x, y, v - 2.0 * self.bend.abs(), psi, 0.0, 0.0, 0.0]);
        stage.du_min = -Input::from(SLEW);
        stage.du_max = Input::from(SLEW);
        let row = |index: usize, lower: f64, upper: f64| SoftRow {
            normal: State::ith(index, 1.0),
            lower,
            upper,
        };
        let mut normal = State::zeros();
        (normal[0], normal[1]) = (-sin, cos);
        let offset = -sin * x + cos * y;
        stage.soft = [
            row(2, 0.0, v + 1.0),
            row(6, -0.91, 0.91),
            SoftRow {
                normal,
                lower: offset - 2.0,
                upper: offset + 2.0,
            },
            row(4, -3.0, 3.0),
            row(5, -1.5, 1.5),
        ];
        stage
    }
}

/// Sets the terminal weight and widens the bounds to the inputs that the slew limits let the applied input reach.
fn finish(qp: &mut OcpQp) {
    let horizon = qp.horizon();
    let (mut low, mut high) = (qp.u_prev, qp.u_prev);
    for stage in qp.stages_mut() {
        let v = stage.soft[0].upper - 1.0;
        let (lower, upper) = ([-8.0, -0.4], [6.0_f64.min(54.7 / v), 0.4]);
        for i in 0..NU {
            low[i] = f64::max(low[i] - SLEW[i], lower[i]);
            high[i] = f64::min(high[i] + SLEW[i], upper[i]);
            stage.u_min[i] = f64::min(lower[i], high[i]);
            stage.u_max[i] = f64::max(upper[i], low[i]);
            low[i] = low[i].clamp(stage.u_min[i], stage.u_max[i]);
            high[i] = high[i].clamp(stage.u_min[i], stage.u_max[i]);
        }
    }
    qp.stages_mut()[horizon - 1].q *= 2.0;
}

/// Inputs of a solution shifted by one period; the last input is repeated.
pub fn shifted(u: &[Input]) -> Vec<Input> {
    let mut guess = u[1..].to_vec();
    guess.push(u[u.len() - 1]);
    guess
}
