"""Least squares with many residuals and few unknowns, solved by their normal equations."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import solve_triangular

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray


class NormalEquationProblem:
    """A least-squares problem that is given by Jᵀ J, Jᵀ r and rᵀ r of residuals r and slopes J.

    It has n + 1 residuals for n unknowns, however many r has. With Jᵀ J = L Lᵀ the residuals
    [L⁻¹ Jᵀ r, q], where q² = rᵀ r - |L⁻¹ Jᵀ r|², and their derivatives [Lᵀ, 0] have the same sum of
    squares, gradient and Gauss-Newton Hessian as r and J. These are all that `least_squares` uses,
    which decomposes J in each iteration.
    """

    def __init__(
        self,
        normal_equations: Callable[
            [NDArray[np.float64]], tuple[NDArray[np.float64], NDArray[np.float64], float]
        ],
    ) -> None:
        """Use a function that returns Jᵀ J (n, n), Jᵀ r (n,) and rᵀ r at x (n,)."""
        self._normal_equations = normal_equations
        self._last: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None

    def residuals(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the residuals at x (n + 1,), infinite where the equations cannot be solved."""
        square, gradient, total = self._normal_equations(x)
        try:
            lower = np.linalg.cholesky(square)
        except np.linalg.LinAlgError:
            lower = np.full_like(square, np.nan)
        if not (np.isfinite(total) and np.isfinite(lower).all()):
            return np.full(len(x) + 1, np.inf)
        inside = solve_triangular(lower, gradient, lower=True)
        self._last = x.copy(), np.vstack([lower.T, np.zeros(len(x))])
        return np.append(inside, math.sqrt(max(total - float(inside @ inside), 0.0)))

    def jacobian(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the derivatives (n + 1, n) at x, NaN where the equations cannot be solved."""
        if self._last is None or not np.array_equal(self._last[0], x):
            self._last = None
            self.residuals(x)
        return np.full((len(x) + 1, len(x)), np.nan) if self._last is None else self._last[1]
