"""Libraries: how they are read and written."""

from collections.abc import Mapping, Sequence
from os import PathLike
from typing import final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from egp_service._core.vehicle import VehicleParameters

@final
class Library:
    """A verified library: one member for each surface. It does not change after it was loaded.

    Pickle hands the file's bytes over to another process, which verifies and factors them again.
    """

    @staticmethod
    def load(path: str | PathLike[str]) -> Library:
        """Read, verify and factor a library file.

        Raises:
            LibraryError: for a file that fails a check.
            OSError: for a file that cannot be read, such as a folder, which is an
                `IsADirectoryError`, or a pipe.

        """
    def __copy__(self) -> Library: ...
    def __deepcopy__(self, memo: object, /) -> Library: ...
    @property
    def id(self) -> str:
        """SHA-256 of the file, hexadecimal; each request states it."""
    @property
    def dt(self) -> float:
        """Period over which the outputs change, s."""
    @property
    def kernel(self) -> str:
        """Name of the kernel, such as "matern52"."""
    @property
    def vehicle(self) -> str:
        """Name of the vehicle that the data come from."""
    @property
    def parameters(self) -> VehicleParameters:
        """Parameters of the vehicle that the data come from."""
    @property
    def measurement_noise(self) -> NDArray[np.float64] | None:
        """Standard deviations (3,) of the white noise of the measured `[v_x, v_y, omega]`.

        In m/s, m/s and rad/s, as found in the logs that the library was trained on; None if it was
        trained on simulated data.
        """
    @property
    def measurement_delay(self) -> float | None:
        """Time in s by which the measured `[v_x, v_y, omega]` are late.

        As found in the logs that the library was trained on; None if they do not tell it, or if the
        data were simulated.
        """
    @property
    def provenance(self) -> dict[str, str]:
        """How the library was made: versions, settings, seeds."""
    @property
    def members(self) -> list[Member]:
        """The members, in the order of the weights."""
    def predict(
        self, z: ArrayLike, member: int = 0
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Predict with one member at GP inputs `z` (n, 6).

        Rows of `z` are `[v_x, v_y, omega, delta, F_x, delta_dot]` in m/s, m/s, rad/s, rad, N and
        rad/s. Returns the mean (n, 3), its Jacobian (n, 3, 6) and the variance of the latent
        function, which excludes measurement noise, (n, 3). The mean is the change of
        `[v_x, v_y, omega]` over `dt`, in m/s, m/s and rad/s, and the variance has the squares of
        these units.

        >>> import numpy as np
        >>> from egp_service import Library
        >>> from egp_service.simulation.scenario import library_path, load_scenario
        >>> library = Library.load(library_path(load_scenario("rounded-rectangle")))
        >>> z = np.array([[15.0, 0.1, 0.2, 0.03, 500.0, 0.0]])
        >>> mean, jacobian, variance = library.predict(z)
        >>> step = np.array([[0.0, 0.0, 0.0, 1e-5, 0.0, 0.0]])
        >>> slope = (library.predict_mean(z + step) - library.predict_mean(z - step)) / 2e-5
        >>> bool(np.allclose(jacobian[:, :, 3], slope)), bool((variance > 0.0).all())
        (True, True)

        Raises:
            IndexError: if there is no such member.
            InvalidArgumentError: for inputs that have another shape, are not finite, or are so
                large that a prediction is not finite.

        """
    def predict_mean(self, z: ArrayLike, member: int = 0) -> NDArray[np.float64]:
        """Mean (n, 3) of one member at GP inputs `z` (n, 6), with the units of `predict`.

        It is that of `predict` up to rounding, and takes a fraction of the time, because the
        variance needs M² operations a point and the mean M, for M points of the member.

        >>> import numpy as np
        >>> from egp_service import Library
        >>> from egp_service.simulation.scenario import library_path, load_scenario
        >>> library = Library.load(library_path(load_scenario("rounded-rectangle")))
        >>> z = np.array([[15.0, 0.1, 0.2, 0.03, 500.0, 0.0]])
        >>> bool(np.allclose(library.predict_mean(z), library.predict(z)[0], rtol=1e-10))
        True

        Raises:
            IndexError: as for `predict`.
            InvalidArgumentError: as for `predict`.

        """

@final
class Member:
    """Vehicle and GPs of one surface; hyperparameters are those of the z-scored space."""

    def __copy__(self) -> Member: ...
    def __deepcopy__(self, memo: object, /) -> Member: ...
    @property
    def label(self) -> str:
        """Name of the surface."""
    @property
    def friction(self) -> float:
        """Nominal friction coefficient of the surface."""
    @property
    def slip_bound(self) -> float:
        """Slip angle in rad, to which the step by default bounds that of the front tyres.

        It is 0.9 times the angle at which the front force is largest: of a single-track vehicle
        `tan(pi / (2 C)) / B`, at most 0.4, and of other members `peak_slip` of the library's
        vehicle times the friction.
        """
    @property
    def lateral_grip(self) -> float:
        """Largest lateral acceleration of a steady bend on this surface, as a fraction of mu g.

        Of a single-track vehicle the smaller peak of its two axles, `min(D_f, D_r) / mu`, without
        the Gaussian processes. Of other members `lateral_grip` of the library's vehicle.
        """
    @property
    def dataset(self) -> str:
        """SHA-256 of the dataset that the member was trained on."""
    @property
    def n_points(self) -> int:
        """Number of training points; 0 for a vehicle alone."""
    @property
    def envelope(self) -> NDArray[np.float64]:
        """Smallest and largest inputs (2, 6) for which the member is meant, as for `predict`."""
    @property
    def lengthscales(self) -> NDArray[np.float64]:
        """Lengthscales of each output (3, 6)."""
    @property
    def outputscale(self) -> NDArray[np.float64]:
        """Prior variances (3,)."""
    @property
    def noise(self) -> NDArray[np.float64]:
        """Noise variances (3,)."""
    @property
    def constant(self) -> NDArray[np.float64]:
        """Prior means (3,)."""
    @property
    def noise_std(self) -> NDArray[np.float64]:
        """Standard deviations of the targets' noise (3,), output units."""
    @property
    def single_track(self) -> NDArray[np.float64] | None:
        """Parameters (17,) of the single-track vehicle that the GPs are added to, or None.

        m, l_f, l_r, k^2 (radius of gyration), h in kg and m; longitudinal grip D_x under drive and
        braking; of the front tyres, then of the rear ones, the coupling e under drive and braking,
        friction D, stiffness B and shape C.
        """
    @property
    def resistance(self) -> NDArray[np.float64] | None:
        """Rolling resistance c_0 in m/s² and drag c_2 in 1/m (2,) of the single-track vehicle.

        It slows by c_0 v_x / max(|v_x|, 3 m/s) + c_2 v_x |v_x|. Zeros unless the library states
        them, and None without such a vehicle.
        """
    @property
    def euler_steps(self) -> int:
        """Number of Euler steps with which the single-track vehicle predicts a period.

        It is 1 without such a vehicle.
        """
    @property
    def kinematic(self) -> NDArray[np.float64] | None:
        """Parameters (3,) of a vehicle whose wheels roll without slip, or None.

        m, l_f and l_r in kg and m.
        """

@final
class MemberData:
    def __new__(
        cls,
        *,
        label: str,
        friction: float,
        dataset: str,
        inputs: ArrayLike,
        targets: ArrayLike,
        input_mean: ArrayLike,
        input_std: ArrayLike,
        target_mean: ArrayLike,
        target_std: ArrayLike,
        lengthscales: ArrayLike,
        outputscale: ArrayLike,
        noise: ArrayLike,
        constant: ArrayLike,
        alpha: ArrayLike,
        envelope: ArrayLike,
        golden_z: ArrayLike,
        golden_mean: ArrayLike,
        golden_jacobian: ArrayLike,
        golden_variance: ArrayLike,
        single_track: ArrayLike | None = None,
        kinematic: ArrayLike | None = None,
        resistance: ArrayLike | None = None,
        euler_steps: int = 1,
    ) -> MemberData: ...

def write_library(
    path: str | PathLike[str],
    *,
    dt: float,
    kernel: str,
    vehicle: str,
    parameters: VehicleParameters,
    members: Sequence[MemberData],
    provenance: Mapping[str, str],
    measurement_noise: ArrayLike | None = None,
    measurement_delay: float | None = None,
) -> None: ...
def write_library_subset(
    source: str | PathLike[str], path: str | PathLike[str], members: Sequence[int]
) -> None: ...
