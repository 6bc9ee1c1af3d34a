"""The messages and the keys of the wire."""

from typing import Final, Literal, final

import numpy as np
from numpy.typing import NDArray

from egp_service._core.vehicle import VehicleParameters

LIVE_KEYS: str
LOAD_KEYS: str
VEHICLE_KEYS: str

@final
class Request:
    library: Final[bytes]
    sequence: Final[int]
    budget_us: Final[int]
    x: Final[NDArray[np.float64]]
    u_prev: Final[NDArray[np.float64]]
    weights: Final[NDArray[np.float64]]
    plan_x: Final[NDArray[np.float64]]
    plan_u: Final[NDArray[np.float64]]
    plan_shift: Final[int]
    history_z: Final[NDArray[np.float64]]
    history_y: Final[NDArray[np.float64]]
    history_f: Final[NDArray[np.float64]]
    reference: Final[NDArray[np.float64]]
    widths: Final[NDArray[np.float64]]
    want_sigma: Final[bool]
    road_friction: Final[NDArray[np.float64]]

@final
class Friction:
    """Posterior of the friction coefficient, from the last transitions and a uniform prior.

    `mean`, standard deviation `std`, the 5 and 95 % quantiles `lower` and `upper`, and the
    `information` of the transitions, which is the divergence from the prior in nats. From 0.1 nats
    on the transitions are `informed`; otherwise the posterior is hardly more than the prior.
    `log_likelihood` (17,) has the logarithms of the likelihoods of the coefficients
    0.1 * 13 ** (i / 16), which are `FRICTION_HYPOTHESES`, relative to the largest. `misfit` tests
    the predictions with the likeliest coefficient for bias: without a systematic error it is 1 on
    average, with a median of 0.79. It is larger if no coefficient explains the transitions, as with
    the library of another vehicle or an unusual load (docs/problem.md, section 8).
    """

    mean: Final[float]
    std: Final[float]
    lower: Final[float]
    upper: Final[float]
    information: Final[float]
    informed: Final[bool]
    log_likelihood: Final[NDArray[np.float64]]
    misfit: Final[float]
    def __new__(
        cls,
        mean: float,
        std: float,
        lower: float,
        upper: float,
        information: float,
        informed: bool,
        log_likelihood: NDArray[np.float64],
        misfit: float,
    ) -> Friction: ...
    def __getnewargs__(
        self,
    ) -> tuple[float, float, float, float, float, bool, NDArray[np.float64], float]: ...

@final
class Reply:
    library: Final[bytes]
    sequence: Final[int]
    status: Final[
        Literal["solved", "iteration_limit", "infeasible", "numerical_error", "check_failed"]
    ]
    plan_x: Final[NDArray[np.float64]]
    plan_u: Final[NDArray[np.float64]]
    weights: Final[NDArray[np.float64]]
    sigma: Final[NDArray[np.float64]]
    history_f: Final[NDArray[np.float64]]
    dropped_mass: Final[float]
    iterations: Final[int]
    kkt_residual: Final[float]
    solver: Final[str]
    friction: Final[Friction | None]

@final
class Ready:
    ready: Final[bool]
    library: Final[bytes]
    others: Final[list[bytes]]
    dt: Final[float]
    horizon: Final[int]
    history: Final[int]
    members: Final[list[str]]
    envelope: Final[list[list[float]]]
    vehicle: Final[VehicleParameters | None]

def decode_request(data: bytes) -> Request: ...
def decode_reply(data: bytes) -> Reply: ...
def decode_ready(data: bytes) -> Ready: ...
def file_descriptor_set() -> bytes: ...
def replica_of_live(key: str) -> str | None: ...
def replica_of_load(key: str) -> str | None: ...
def vehicle_key(fleet: str, vehicle: str) -> str: ...
def vehicle_road_key(fleet: str, vehicle: str) -> str: ...
def publishing_vehicle(key: str) -> tuple[str, str] | None: ...
