"""One figure of an evaluation, or why it has none; and the figures that results are compared by."""

from __future__ import annotations

import math
from dataclasses import dataclass

from posetrack_cli.evaluation.evaluation import Evaluation
from posetrack_cli.evaluation.metrics.catalogue import Address, split_address
from posetrack_cli.evaluation.statistics import Statistics

KEY_FIGURES: dict[str, tuple[str, ...]] = {
    "hand": (
        "coverage",
        "joint_error_mm.mean",
        "joint_error_mm.p95",
        "fingertip_error_mm.mean",
        "largest_joint_error_mm.median",
        "wrist_position_mm.mean",
        "wrist_rotation_deg.mean",
        "angle_error_deg.mean",
    ),
    "head": (
        "coverage",
        "x_mm.mean",
        "y_mm.mean",
        "z_mm.mean",
        "roll_deg.mean",
        "pitch_deg.mean",
        "yaw_deg.mean",
        "position_mm.mean",
        "rotation_deg.mean",
        "point_error_mm.mean",
    ),
}
"""By subject: how good a track is, in a few figures. Regressions are found in these."""

STUDIED_FIGURES: dict[str, tuple[str, ...]] = {
    "hand": (
        *KEY_FIGURES["hand"],
        "frames_within_40mm",
        "velocity_error_mm_s.mean",
        "angular_velocity_error_deg_s.mean",
        "angle_velocity_error_deg_s.mean",
        "inside_90",
        "jitter_mm.mean",
        "ms_per_frame.median",
    ),
    "head": (
        *KEY_FIGURES["head"],
        "velocity_error_mm_s.mean",
        "angular_velocity_error_deg_s.mean",
        "inside_90",
        "jitter_mm.mean",
        "ms_per_frame.median",
    ),
}
"""By subject: what groups of results are compared by, one figure of each result."""


@dataclass(frozen=True)
class Figure:
    """A finite value, or None and the reason."""

    value: float | None
    reason: str = ""


def figure_of(evaluation: Evaluation, address: Address | str) -> Figure:
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


def _why_not(evaluation: Evaluation, address: Address) -> str:
    """Why there is no such figure, or nothing."""
    if not evaluation.coverage.frames:
        return "the result holds no estimate"
    if evaluation.subject not in address.metric.subjects:
        return f"it is no metric of a {evaluation.subject}"
    if address.base in evaluation.metrics:
        return ""
    return evaluation.absent.get(address.base) or evaluation.absent.get(address.metric.name, "not measured")
