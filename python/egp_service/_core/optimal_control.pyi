"""The optimal control problem of eq. (18) and the weights of eq. (6) by themselves."""

from typing import Literal, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

@final
class OcpWeights:
    """Quadratic cost of `solve_ocp`; every term is `1/2 weight * error^2`.

    q (T, 7, 7) weights the error of the state after each input; it is symmetric, with a block for
    the position and a diagonal. Diagonals r (2,), positive, weight inputs, and r_d (2,) their
    changes, the first of which is from `u_prev`. The proximal term, none by default, weights the
    difference of each input to that of the previous plan, `planned` (T, 2), with a diagonal
    `proximal` (T, 2), at least 0. Arrays without their axis T hold for all stages. States and
    inputs have the units of `solve_ocp`. Attributes are copies.

    Raises:
        InvalidArgumentError: unless r and r_d have the shape (2,), r is positive and r_d at least
            0, all finite. `solve_ocp` checks the rest.

    """

    def __new__(
        cls,
        *,
        q: ArrayLike,
        r: ArrayLike,
        r_d: ArrayLike,
        proximal: ArrayLike | None = None,
        planned: ArrayLike | None = None,
    ) -> OcpWeights: ...
    @property
    def q(self) -> NDArray[np.float64]: ...
    @property
    def r(self) -> NDArray[np.float64]: ...
    @property
    def r_d(self) -> NDArray[np.float64]: ...
    @property
    def proximal(self) -> NDArray[np.float64]: ...
    @property
    def planned(self) -> NDArray[np.float64]: ...

@final
class OcpBounds:
    """Bounds of `solve_ocp`, all finite.

    Hard ones, (T, 2): u_min, u_max on inputs and du_min, du_max on their changes. Soft ones on n <=
    5 rows: `soft_lower <= soft_normal x <= soft_upper`, (T, n), (T, n, 7), (T, n), where a
    violation s costs `linear * s + 1/2 quadratic * s^2` with positive penalty rows [linear,
    quadratic] (n, 2). The first row may involve v_x, the second delta, the third p_x and p_y, the
    fourth v_y, the fifth omega; a row of zeros bounds nothing. Arrays without their axis T hold for
    all stages. States and inputs have the units of `solve_ocp`. Attributes are copies.

    Raises:
        InvalidArgumentError: unless penalty has at most five rows, all finite and positive.
            `solve_ocp` checks the rest.

    """

    def __new__(
        cls,
        *,
        u_min: ArrayLike,
        u_max: ArrayLike,
        du_min: ArrayLike,
        du_max: ArrayLike,
        soft_normal: ArrayLike | None = None,
        soft_lower: ArrayLike | None = None,
        soft_upper: ArrayLike | None = None,
        penalty: ArrayLike | None = None,
    ) -> OcpBounds: ...
    @property
    def u_min(self) -> NDArray[np.float64]: ...
    @property
    def u_max(self) -> NDArray[np.float64]: ...
    @property
    def du_min(self) -> NDArray[np.float64]: ...
    @property
    def du_max(self) -> NDArray[np.float64]: ...
    @property
    def soft_normal(self) -> NDArray[np.float64]: ...
    @property
    def soft_lower(self) -> NDArray[np.float64]: ...
    @property
    def soft_upper(self) -> NDArray[np.float64]: ...
    @property
    def penalty(self) -> NDArray[np.float64]: ...

@final
class OcpResult:
    """Solution of an optimal control problem, or why there is none."""

    @property
    def status(self) -> str:
        """One of "solved", "iteration_limit", "infeasible", "numerical_error", "check_failed".

        "infeasible" means that no sequence of inputs satisfies the hard bounds.
        """
    @property
    def x(self) -> NDArray[np.float64]:
        """States (T+1, 7), `[p_x, p_y, v_x, psi, v_y, omega, delta]` in SI units."""
    @property
    def u(self) -> NDArray[np.float64]:
        """Inputs (T, 2): acceleration in m/s² and steering rate in rad/s."""
    @property
    def cost(self) -> float:
        """Cost of the inputs `u`, with the penalties of violated soft rows.

        Infinite if the solver gave none.
        """
    @property
    def multipliers(self) -> OcpMultipliers:
        """Lagrange multipliers of the inequalities, for the rows as they were stated."""
    @property
    def iterations(self) -> int:
        """Iterations of the last solver."""
    @property
    def kkt_residual(self) -> float:
        """Largest of stationarity, primal, dual and complementarity residual.

        All but the primal one are relative to the size of their terms, which counts as at least 1.
        """
    @property
    def solver(self) -> str:
        """Name of the last solver, which gave the result."""
    @property
    def seconds(self) -> float:
        """Shortest time of all repetitions, s, with the check of the residual."""

@final
class OcpMultipliers:
    """Lagrange multipliers of the inequalities of `solve_ocp`, all at least 0 at a solution.

    Each is the derivative of the cost in its bound: in a lower one, and in an upper one the
    negative derivative. Rows are the stages, columns the inputs or the soft rows.
    """

    @property
    def u_min(self) -> NDArray[np.float64]:
        """Multipliers (T, 2) of the lower bounds of inputs."""
    @property
    def u_max(self) -> NDArray[np.float64]:
        """Multipliers (T, 2) of the upper bounds of inputs."""
    @property
    def du_min(self) -> NDArray[np.float64]:
        """Multipliers (T, 2) of the lower bounds of changes of inputs."""
    @property
    def du_max(self) -> NDArray[np.float64]:
        """Multipliers (T, 2) of the upper bounds of changes of inputs."""
    @property
    def soft_lower(self) -> NDArray[np.float64]:
        """Multipliers (T, n) of `soft_lower - s <= soft_normal x`, with the violation s."""
    @property
    def soft_upper(self) -> NDArray[np.float64]:
        """Multipliers (T, n) of `soft_normal x <= soft_upper + s`, with the violation s."""

def solve_ocp(
    A: ArrayLike,
    B: ArrayLike,
    c: ArrayLike,
    x0: ArrayLike,
    u_prev: ArrayLike,
    reference: ArrayLike,
    weights: OcpWeights,
    bounds: OcpBounds,
    *,
    solver: Literal["riccati", "clarabel"] = "riccati",
    guess: ArrayLike | None = None,
    repeat: int = 1,
) -> OcpResult:
    """Solve a linear time-varying optimal control problem, eq. (18).

    The dynamics are x_{t+1} = A_t x_t + B_t u_t + c_t, t = 0..T-1, with states [p_x, p_y, v_x, psi,
    v_y, omega, delta] in SI units and rad and inputs [acceleration, steering rate] in m/s² and
    rad/s: A (T, 7, 7), B (T, 7, 2), c (T, 7), measured state x0 (7,), input now applied u_prev
    (2,), and reference (T, 7) of x_1..x_T. Arrays of problem, weights and bounds without their axis
    T hold for all stages, except A.

    Entries may be different from zero where the vehicle's equations have them, eq. (11) with
    positions along the yaw of any moment of the period: position rows of A at themselves, v_x, psi,
    v_y and omega; yaw at itself and omega; v_x, v_y and omega at each other and delta; delta at
    itself; rows v_x, v_y and omega of B, and delta's at the steering rate.

    `solver` is called first; if its answer fails the check of the residual, "clarabel" is called
    after it. `guess` (T, 2) holds inputs to start from, such as those of the last plan,
    shifted. The problem is solved `repeat` times to measure `seconds`; each solve starts from the
    arguments only.

    Drive 1 m/s faster within a second, on a straight:

    >>> import numpy as np
    >>> from egp_service.optimal_control import OcpBounds, OcpWeights, solve_ocp
    >>> dt, T = 0.05, 20
    >>> A = np.tile(np.eye(7), (T, 1, 1))
    >>> A[:, 0, 2] = A[:, 1, 4] = A[:, 3, 5] = dt
    >>> B = np.zeros((7, 2))
    >>> B[2, 0] = B[6, 1] = dt
    >>> weights = OcpWeights(q=np.diag([0, 0, 10, 0, 0, 0, 0]), r=[0.05, 2], r_d=[0.05, 5])
    >>> bounds = OcpBounds(u_min=[-8, -0.4], u_max=[2, 0.4], du_min=[-1, -0.4], du_max=[1, 0.4])
    >>> x0, reference = [0, 0, 10, 0, 0, 0, 0], [0, 0, 11, 0, 0, 0, 0]
    >>> problem = A, B, np.zeros(7), x0, [0, 0], reference, weights, bounds
    >>> result = solve_ocp(*problem)
    >>> result.status, result.kkt_residual < 1e-6
    ('solved', True)
    >>> np.abs(result.u[:4, 0].round(6)).tolist(), result.x.shape
    ([1.0, 2.0, 2.0, 2.0], (21, 7))
    >>> bool(np.abs(result.u - solve_ocp(*problem, solver="clarabel").u).max() < 1e-6)
    True

    Raises:
        InvalidArgumentError: for a wrong shape, numbers that are not finite, bounds that cross, and
            entries where the equations have none; it names the argument and the stage.

    """

def ocp_to_qp(
    A: ArrayLike,
    B: ArrayLike,
    c: ArrayLike,
    x0: ArrayLike,
    u_prev: ArrayLike,
    reference: ArrayLike,
    weights: OcpWeights,
    bounds: OcpBounds,
) -> tuple[
    tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]],
    NDArray[np.float64],
    tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]],
    NDArray[np.float64],
    NDArray[np.float64],
]:
    """Write an optimal control problem as `min 1/2 z'Pz + q'z` subject to `l <= Az <= u`.

    For other solvers, such as OSQP. The arguments are those of `solve_ocp`. Returns P (upper
    triangle), q (n,), A, l (m,) and u (m,), where an absent bound is infinite. P and A are in
    compressed sparse columns: values, row indices and column starts, as `scipy.sparse.csc_array`
    takes them. `z` has, stage by stage, the inputs `u_t` (2,), `x_{t+1} - reference_{t+1}` (7,) and
    the violations of the soft rows.

    >>> import numpy as np
    >>> from egp_service.optimal_control import OcpBounds, OcpWeights, ocp_to_qp
    >>> weights = OcpWeights(q=np.eye(7), r=[1, 1], r_d=[0, 0])
    >>> bounds = OcpBounds(u_min=[-1, -1], u_max=[1, 1], du_min=[-1, -1], du_max=[1, 1])
    >>> zero = np.zeros(7)
    >>> problem = np.eye(7)[None], np.zeros((7, 2)), zero, zero, [0, 0], zero, weights, bounds
    >>> (values, rows, starts), q, A, l, u = ocp_to_qp(*problem)
    >>> q.shape, l.shape, starts.tolist()
    ((9,), (11,), [0, 1, 2, 3, 5, 6, 7, 8, 9, 10])

    Raises:
        InvalidArgumentError: as for `solve_ocp`.

    """

def solve_weights(
    predictions: ArrayLike,
    measured: ArrayLike,
    noise_std: ArrayLike,
    previous: ArrayLike,
    prior: Literal["quadratic", "l1"],
    strength: float,
    measurement_std: ArrayLike | None = None,
) -> NDArray[np.float64]:
    """Solve for the weights (N,), eq. (6).

    Minimises the squared whitened errors of predictions (k, N, 3) against measured (k, 3), plus
    `strength` times the squared or absolute distance from the previous weights (N,), on the
    simplex. The outputs are the changes of [v_x, v_y, omega] in m/s, m/s and rad/s.
    noise_std (3,) is the standard deviation of the predictions' own noise in these units. With
    measurement_std (3,), that of the measured states, the k transitions have to be consecutive: an
    output's errors then have the covariance noise_std² + 2 measurement_std², and neighbours
    -measurement_std².

    The measurement is halfway between the predictions of two members:

    >>> import numpy as np
    >>> from egp_service.optimal_control import solve_weights
    >>> predictions = np.array([[[0.1, 0.0, 0.0], [0.3, 0.0, 0.0]]])
    >>> measured = np.array([[0.2, 0.0, 0.0]])
    >>> solve_weights(
    ...     predictions, measured, np.full(3, 0.01), np.array([0.9, 0.1]), "quadratic", 1e-6
    ... ).round(4).tolist()
    [0.5, 0.5]

    Raises:
        InvalidArgumentError: for shapes that differ, for numbers outside their domain and unless
            `strength` is from 0 to 1e300.

    """

def predict_residual(
    errors: ArrayLike,
    *,
    dt: float,
    window: int,
    std: ArrayLike,
    time: ArrayLike,
    noise: ArrayLike,
    measurement: ArrayLike,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Predict each of consecutive errors (n, 3) of a model from at most `window` before it.

    An error is the measured change of [v_x, v_y, omega] over one period of dt s less the predicted
    one. It consists of a disturbance with standard deviations `std` and correlation times `time` in
    s, of independent errors with standard deviations `noise`, and of the measured states' noise
    with `measurement`, each (3,), as in the control step with the settings of `[residual]`.
    Returns the predictions (n, 3) and the variances (n, 3) of the disturbance; zero if `std` and
    `measurement` are.

    A constant disturbance is found from the errors before, and limited to three times `std`:

    >>> import numpy as np
    >>> from egp_service.optimal_control import predict_residual
    >>> mean, _ = predict_residual(
    ...     np.full((50, 3), 0.02),
    ...     dt=0.04,
    ...     window=12,
    ...     std=np.array([0.02, 0.005, 0.0]),
    ...     time=np.full(3, 1e4),
    ...     noise=np.full(3, 0.01),
    ...     measurement=np.zeros(3),
    ... )
    >>> mean[-1].round(4).tolist()
    [0.0196, 0.015, 0.0]

    Raises:
        InvalidArgumentError: for other shapes and for numbers outside their domain.

    """
