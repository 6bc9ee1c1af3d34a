"""The textbook sums as numba compiles them: a pass over the training points a query and output."""

from __future__ import annotations

import importlib.util
import math
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from gp import Answer, Array, Textbook


def compiled(book: Textbook) -> Callable[[Array, Sequence[int]], Answer] | None:
    """Return a program for the member of `book`, or None if numba is not installed."""
    if importlib.util.find_spec("numba") is None:
        return None
    import numba  # noqa: PLC0415

    evaluate: Any = numba.njit(fastmath=True)(sums)

    def program(z: Array, outputs: Sequence[int]) -> Answer:
        means = np.empty((len(z), len(outputs)))
        jacobians = np.empty((len(z), len(outputs), 6))
        for at, o in enumerate(outputs):
            x = scaled[o]
            evaluate(z / book.lengths[o], x, weights[o], means[:, at], jacobians[:, at])
            scale = book.target_std[o]
            means[:, at] = book.target_mean[o] + scale * (book.constant[o] + means[:, at])
            jacobians[:, at] *= scale / book.lengths[o]
        return means, jacobians

    # Dimensions first, so that the loop over points is contiguous and vectorises.
    scaled = [np.ascontiguousarray((book.x / lengths).T) for lengths in book.lengths]
    weights = book.alpha * book.prior[:, None]
    return program


def sums(a: Array, x: Array, weights: Array, mean: Array, jacobian: Array) -> None:
    """Sum the kernel times its weight, and its slopes, over the points `x` (6, M)."""
    for q in range(a.shape[0]):
        total = s0 = s1 = s2 = s3 = s4 = s5 = 0.0
        for m in range(x.shape[1]):
            d0, d1, d2 = x[0, m] - a[q, 0], x[1, m] - a[q, 1], x[2, m] - a[q, 2]
            d3, d4, d5 = x[3, m] - a[q, 3], x[4, m] - a[q, 4], x[5, m] - a[q, 5]
            square = d0 * d0 + d1 * d1 + d2 * d2 + d3 * d3 + d4 * d4 + d5 * d5
            k = weights[m] * math.exp(-0.5 * square)
            total += k
            s0 += k * d0
            s1 += k * d1
            s2 += k * d2
            s3 += k * d3
            s4 += k * d4
            s5 += k * d5
        mean[q] = total
        jacobian[q, 0], jacobian[q, 1], jacobian[q, 2] = s0, s1, s2
        jacobian[q, 3], jacobian[q, 4], jacobian[q, 5] = s3, s4, s5
