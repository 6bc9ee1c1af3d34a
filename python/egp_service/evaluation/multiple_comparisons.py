"""Tests of many paired comparisons at once, with one probability of a false finding among all."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.stats import wilcoxon

if TYPE_CHECKING:
    from collections.abc import Sequence

LEVEL: Final = 0.05
"""Largest probability that any comparison of two equal contenders counts as a finding."""


def positive(gains: Sequence[float]) -> float:
    """Return the p-value of Wilcoxon's signed-rank test that `gains` are symmetric about zero.

    The alternative is that they are positive. Differences of zero are left out; without any
    other difference the value is 1. Without ties the smallest value for `n` gains, up to 50, is
    `2**-n`; otherwise scipy uses a normal approximation from 14 gains on.
    """
    if not np.any(gains):
        return 1.0
    return float(wilcoxon(gains, alternative="greater").pvalue)


def holm(p_values: Sequence[float]) -> list[bool]:
    """Return which hypotheses Holm's procedure rejects at the family-wise level `LEVEL`.

    The `k`-th smallest of `m` p-values, from `k = 0` on, is compared with `LEVEL / (m - k)`; the
    first one above ends the rejections (Holm, "A simple sequentially rejective multiple test
    procedure", 1979).
    """
    rejected = [False] * len(p_values)
    for k, index in enumerate(np.argsort(p_values, kind="stable")):
        if p_values[index] > LEVEL / (len(p_values) - k):
            break
        rejected[index] = True
    return rejected
