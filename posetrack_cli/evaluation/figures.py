"""One figure of an evaluation, or why it has none; and the figures that results are compared by."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from posetrack_cli.evaluation.coverage import Coverage
from posetrack_cli.evaluation.evaluation import Statistics, Value
from posetrack_cli.evaluation.metrics.catalogue import Address, is_measured, split_address
from posetrack_cli.evaluation.subjects import KINDS

_ALWAYS = ("coverage",)
"""What there is of every subject, also of one that is not known here."""


def key_figures(subject: str) -> tuple[str, ...]:
    """Return how good a track is, in a few figures. Regressions are found in these."""
    return KINDS[subject].key_figures if subject in KINDS else _ALWAYS


def studied_figures(subject: str) -> tuple[str, ...]:
    """Return what groups of results are compared by, one figure of each result."""
    return (*key_figures(subject), *(KINDS[subject].studied_figures if subject in KINDS else ()))


class Measured(Protocol):
    """What figures are of: a result, or several that are pooled."""

    @property
    def name(self) -> str:
        """What it is called."""

    @property
    def subject(self) -> str:
        """A key of ``KINDS``."""

    @property
    def coverage(self) -> Coverage:
        """Its counts of frames."""

    @property
    def metrics(self) -> Mapping[str, Value]:
        """Values by address."""

    @property
    def absent(self) -> Mapping[str, str]:
        """Why other addresses have none."""


@dataclass(frozen=True)
class Figure:
    """A finite value, or None and the reason."""

    value: float | None
    reason: str = ""


def figure_of(evaluation: Measured, address: Address | str) -> Figure:
    """Look a figure up by its full address, such as ``joint_error_mm.mean`` or ``coverage``.

    Raises:
        UsageError: there is no such metric, part or statistic.
    """
    address = split_address(address) if isinstance(address, str) else address
    reason = _why_not(evaluation, address)
    if reason:
        return Figure(None, reason)
    measured = evaluation.metrics[address.base]
    value = getattr(measured, address.statistic or "") if isinstance(measured, Statistics) else measured
    if not math.isfinite(value):
        return Figure(None, f"the figure is {value}")
    return Figure(float(value))


def _why_not(evaluation: Measured, address: Address) -> str:
    """Why there is no such figure, or nothing."""
    if not evaluation.coverage.frames:
        return "the result holds no estimate"
    if not is_measured(address.metric, KINDS[evaluation.subject]):
        return f"it is no metric of a {evaluation.subject}"
    if address.base in evaluation.metrics:
        return ""
    return evaluation.absent.get(address.base) or evaluation.absent.get(address.metric.name, "not measured")
