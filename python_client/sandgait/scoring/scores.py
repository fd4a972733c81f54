"""The error of the scoreboard. It is defined here, once, for all rows and entries.

    error = √( Σ |F − F_measured|² / Σ |F_measured|² )

The sums are over the samples of a group. An entry without an error has 0, and one without a force has 1 (100 %). The
error of a set is the root mean square of its groups' errors. A walk has speeds in place of forces.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

#: Bootstrap resamples of an interval: as many as `sandgait validate` has (src/validate/score.rs).
RESAMPLES = 400
#: Ends of a 95 % interval.
ENDS = (0.025, 0.975)


@dataclass(frozen=True)
class Score:
    """Errors of one entry in a group or a set; shares of the measured force, so 1 is 100 %."""

    rows: int
    error: float
    #: Ends of the 95 % interval; NaN if one of the groups has only one condition.
    low: float
    high: float
    #: F · F_measured over F_measured²: 1 if the force is right on average, 0 if there is none.
    ratio: float
    #: Parts of the error along each axis. Their squares add up to that of the error.
    parts: tuple[float, ...]


def score(pairs: Sequence[tuple[Array, Array, npt.NDArray[Any]]]) -> Score:
    """The score of a set: for each of its groups predicted and measured values [samples, components], and the condition
    of each sample."""
    squares, products, parts, draws = [], [], [], []
    for predicted, measured, condition in pairs:
        missed, there = (predicted - measured) ** 2, (measured**2).sum()
        squares.append(missed.sum() / there)
        parts.append(missed.sum(axis=0) / there)
        products.append((predicted * measured).sum() / there)
        draws.append(_drawn(missed.sum(axis=1), (measured**2).sum(axis=1), condition))
    low, high = np.quantile(np.sqrt(np.mean(draws, axis=0)), ENDS)
    means = np.sqrt(np.mean(parts, axis=0))
    rows = sum(len(measured) for _, measured, _ in pairs)
    error = float(np.sqrt(np.mean(squares)))
    return Score(rows, error, float(low), float(high), float(np.mean(products)), tuple(map(float, means)))


def _drawn(missed: Array, there: Array, condition: npt.NDArray[Any]) -> Array:
    """Squares of the error of a group, in resamples of its conditions."""
    _, index = np.unique(condition, return_inverse=True)
    count = index.max() + 1
    if count < 2:
        return np.full(RESAMPLES, np.nan)
    sums = np.stack([np.bincount(index, x) for x in (missed, there)])
    chosen = np.random.default_rng(1).integers(count, size=(RESAMPLES, count))
    above, below = sums[:, chosen].sum(axis=2)
    return np.asarray(above / below)
