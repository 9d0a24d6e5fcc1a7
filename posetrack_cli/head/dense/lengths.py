"""Lengths of a face, and what is usual for a person: lids, lips, jaw, brows **[ours]**.

Each length has a histogram over the frames of a person, which begins with that of people in general. A
person's open lids, closed lips and resting brows are quantiles of it, so they are vague at first and become
certain with time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, NamedTuple

import numpy as np

from posetrack_cli.arrays import FloatArray, IntArray
from posetrack_cli.head.dense.points import DENSE_COUNT, LEFT_BROW, LEFT_LIDS, RIGHT_BROW, RIGHT_LIDS, rows
from posetrack_cli.results.columns import counts

BINS, BIN_MM = 256, 0.25
OPENING = np.array([0.0, 1.0, 0.3])
"""From the lower to the upper lip when the jaw opens; lengths along it are about distances."""
PRIOR_FRAMES = 45
"""Number of frames that people in general count for."""


class Length(NamedTuple):
    """A length that is measured in each frame.

    Attributes:
        name: its name.
        least_mm: lower end of its histogram.
        usual_mm, spread_mm: mean and standard deviation between people of the value at rest.
        rest: quantile of a person's values that is the value at rest.
    """

    name: str
    least_mm: float
    usual_mm: float
    spread_mm: float
    rest: float


LENGTHS = (
    Length("lip_gap", -4.0, 1.0, 0.7, 0.15),
    Length("jaw", 30.0, 68.0, 4.0, 0.25),
    Length("mouth_width", 20.0, 55.0, 4.0, 0.5),
    Length("right_brow_inner", -10.0, 26.0, 2.5, 0.4),
    Length("right_brow_outer", -10.0, 24.0, 2.5, 0.4),
    Length("left_brow_inner", -10.0, 26.0, 2.5, 0.4),
    Length("left_brow_outer", -10.0, 24.0, 2.5, 0.4),
    Length("right_lid", -4.0, 9.5, 1.5, 0.6),
    Length("left_lid", -4.0, 9.5, 1.5, 0.6),
)
LENGTH_NAMES = tuple(length.name for length in LENGTHS)
"""Names of the L lengths."""
GAP = LENGTH_NAMES.index("lip_gap")
JAW = LENGTH_NAMES.index("jaw")
WIDTH = LENGTH_NAMES.index("mouth_width")
BROWS = [index for index, name in enumerate(LENGTH_NAMES) if "brow" in name]
LIDS = [index for index, name in enumerate(LENGTH_NAMES) if "lid" in name]


def _ends() -> FloatArray:
    """Return the selections (2, L, D) of both ends of each length: means over points."""
    ends = np.zeros((2, len(LENGTHS), DENSE_COUNT))

    def set_ends(name: str, first: Sequence[int], second: Sequence[int]) -> None:
        for side, numbers in enumerate((first, second)):
            ends[side, LENGTH_NAMES.index(name), rows(*numbers)] = 1.0 / len(numbers)

    set_ends("lip_gap", (62,), (66,))
    set_ends("jaw", (33,), (8,))
    set_ends("mouth_width", (54,), (48,))
    for side, brow, lids in (("right", RIGHT_BROW, RIGHT_LIDS), ("left", LEFT_BROW, LEFT_LIDS)):
        corners = (lids[0], lids[3])
        set_ends(f"{side}_brow_inner", brow[3:], corners)
        set_ends(f"{side}_brow_outer", brow[:2], corners)
        set_ends(f"{side}_lid", lids[1:3], lids[4:])
    return ends


_FIRST, _SECOND = _ends()
_FROM_TO = _FIRST - _SECOND


@dataclass(frozen=True, eq=False)
class Lengths:
    """Lengths of a frame, NaN where unknown.

    Attributes:
        values: (L,) mm; brows: heights above the eye corners.
        deviations: (L,) standard deviations.
    """

    values: FloatArray
    deviations: FloatArray


def lengths_of(places: FloatArray, covariances: FloatArray) -> Lengths:
    """Return the lengths of points (D, 3), mm, with covariances (D, 3, 3); NaN points are unknown."""
    known = ~np.isnan(places[:, 0])
    complete = ~((_FROM_TO != 0.0) & ~known).any(axis=1)
    apart = _FROM_TO @ np.where(known[:, None], places, 0.0)
    values = np.linalg.norm(apart, axis=1)
    values[BROWS] = apart[BROWS, 1]
    # noise makes a distance too long; the opening along the usual direction is the other way about if closed
    values[GAP] = 0.5 * (np.hypot(*apart[GAP, 1:]) + OPENING @ apart[GAP])
    along = apart / np.maximum(values, 1e-6)[:, None]
    along[BROWS] = (0.0, 1.0, 0.0)
    covariance = np.einsum(
        "ld,dij->lij", np.square(_FROM_TO), np.where(known[:, None, None], covariances, 0.0)
    )
    variance = np.einsum("li,lij,lj->l", along, covariance, along)
    return Lengths(np.where(complete, values, np.nan), np.where(complete, np.sqrt(variance), np.nan))


@dataclass(frozen=True, eq=False)
class Person:
    """What is usual for a person.

    Attributes:
        histogram: (L, BINS) frames by length.
    """

    histogram: Annotated[IntArray, counts("lengths", "bins")]

    def after(self, lengths: Lengths, count: int = 1) -> Person:
        """Return the person after ``count`` more frames like this one."""
        known = ~np.isnan(lengths.values)
        bins = _bins(np.where(known, lengths.values, 0.0))
        histogram = self.histogram.copy()
        histogram[known, bins[known]] += count
        return replace(self, histogram=histogram)

    def quantiles(self, shares: FloatArray) -> FloatArray:
        """Return the (L,) quantile of each length that is not exceeded in a share (L,) of the frames."""
        total = _PRIOR + self.histogram
        cumulated = np.cumsum(total, axis=1)
        wanted = shares * cumulated[:, -1]
        above = (cumulated < wanted[:, None]).sum(axis=1)
        at = np.arange(len(LENGTHS)), above
        within = (wanted - cumulated[at] + total[at]) / np.maximum(total[at], 1e-12)
        values: FloatArray = _LEAST + BIN_MM * (above + within)
        return values

    @cached_property
    def rest(self) -> FloatArray:
        """(L,) mm, lengths of the face at rest."""
        return self.quantiles(_REST)

    @property
    def rest_sd(self) -> FloatArray:
        """(L,) mm, standard deviations of ``rest``."""
        frames = self.histogram.sum(axis=1)
        sd: FloatArray = _SPREAD * np.sqrt(PRIOR_FRAMES / (PRIOR_FRAMES + frames))
        return sd


_LEAST = np.array([length.least_mm for length in LENGTHS])
_REST = np.array([length.rest for length in LENGTHS])
_SPREAD = np.array([length.spread_mm for length in LENGTHS])


def _prior() -> FloatArray:
    """Return the histogram (L, BINS) of people in general."""
    centres = _LEAST[:, None] + BIN_MM * (np.arange(BINS) + 0.5)
    usual = np.array([length.usual_mm for length in LENGTHS])
    density = np.exp(-0.5 * np.square((centres - usual[:, None]) / _SPREAD[:, None]))
    histogram: FloatArray = PRIOR_FRAMES * density / density.sum(axis=1, keepdims=True)
    return histogram


def _bins(values: FloatArray) -> IntArray:
    bins: IntArray = np.clip(((values - _LEAST) / BIN_MM).astype(np.int64), 0, BINS - 1)
    return bins


_PRIOR = _prior()
UNKNOWN_PERSON = Person(np.zeros((len(LENGTHS), BINS), dtype=np.int64))
