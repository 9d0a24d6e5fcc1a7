"""Catalogue of all metrics, and lookup of metric values by address."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Protocol

from posetrack_cli.errors import UsageError, nearest_name
from posetrack_cli.evaluation.measuring.evaluation import STATISTIC_NAMES, Statistics, Value
from posetrack_cli.evaluation.measuring.measures import GROUP_TITLES, Better, Metric
from posetrack_cli.evaluation.measuring.pose_metrics import INTERVALS
from posetrack_cli.evaluation.measuring.subjects import KINDS, SubjectKind
from posetrack_cli.evaluation.reading.tracks import Coverage

# Tables, gates, baselines and reports take names, units and meanings from here.
#
# The address of a value is ``name[.part][.statistic]``: ``joint_error_mm.index_tip.p95``, ``coverage``.
# ``Evaluation.metrics`` is keyed by addresses without statistic. Metrics of one kind of subject are in
# ``evaluation.measuring.subjects``.


_NEES = (
    "Normalised estimation error squared (NEES) of {what}, summed over 21 entries for a hand and 6 for a "
    "head; the mean equals that number for a consistent filter, a larger mean indicates overconfidence."
)
_INSIDE = (
    "Share of the entries of {what} whose true value is within +-{width} estimated standard deviations; "
    "{share} for a consistent filter with Gaussian errors."
)


def _in_every_kind(limits: str, relation: str, between: str) -> str:
    """Describe the limits of all kinds of subjects."""
    of_kinds = {kind: getattr(kind, limits) for kind in KINDS.values()}
    return ", ".join(
        f"{kind.name}: {kind.in_words(own, relation, between)}" for kind, own in of_kinds.items() if own
    )


_WRONG = _in_every_kind("right", "above", " or ")
_FAR = _in_every_kind("far", "above", " or ")


def _inside(what: str, percent: int, prefix: str = "") -> Metric:
    name = f"inside_{percent}"
    width, share = f"{INTERVALS[name]:.3f}", f"{percent / 100:g}"
    return Metric(
        f"{prefix}{name}",
        "",
        _INSIDE.format(what=what, width=width, share=share),
        part="state",
        group="covariance",
        better="neither",
        scalar=True,
        spoken=f"{prefix.replace('_', ' ')}inside {percent} % interval",
        pooled=True,
    )


def _honesty(name: str, meaning: str, spoken: str, better: Better = "lower") -> Metric:
    return Metric(name, "", meaning, None, "honesty", better, scalar=True, spoken=spoken, pooled=True)


GENERAL: tuple[Metric, ...] = (
    Metric(
        "coverage",
        "",
        "Share of the expected frames that are tracked and have ground truth; without ground truth, share "
        "of frames that are tracked.",
        group="coverage",
        better="higher",
        scalar=True,
        pooled=True,
    ),
    Metric(
        "frames",
        "",
        "Number of estimates in the result.",
        group="coverage",
        better="neither",
        scalar=True,
        pooled=True,
    ),
    Metric(
        "tracked",
        "",
        "Number of estimates that are not lost.",
        group="coverage",
        better="neither",
        scalar=True,
        pooled=True,
    ),
    Metric(
        "lost",
        "",
        "Number of estimates with status lost; their errors are included in all error metrics.",
        group="coverage",
        scalar=True,
        pooled=True,
    ),
    Metric(
        "reinitialised",
        "",
        "Number of estimates at which the track was reinitialised.",
        group="coverage",
        scalar=True,
        pooled=True,
    ),
    Metric(
        "matched",
        "",
        "Number of estimates with ground truth at their stamp; errors are computed over these.",
        group="coverage",
        better="neither",
        scalar=True,
        pooled=True,
    ),
    Metric(
        "unmatched",
        "",
        "Number of estimates without ground truth at their stamp.",
        group="coverage",
        scalar=True,
        pooled=True,
    ),
    Metric(
        "missed",
        "",
        "Number of frames with ground truth for which the result has no estimate.",
        group="coverage",
        scalar=True,
        pooled=True,
    ),
    Metric(
        "truth_outside",
        "",
        "Number of ground-truth frames before the first or after the last estimate; not counted as missed.",
        group="coverage",
        better="neither",
        scalar=True,
        pooled=True,
    ),
    Metric(
        "identity_switches",
        "",
        "Number of times that the subject of a track changed to another track of the result.",
        group="coverage",
        scalar=True,
        pooled=True,
    ),
    Metric(
        "false_tracks",
        "",
        "Number of tracks that follow no subject of the ground truth.",
        group="coverage",
        scalar=True,
        pooled=True,
    ),
    Metric(
        "missed_tracks",
        "",
        "Number of subjects of the ground truth without a track.",
        group="coverage",
        scalar=True,
        pooled=True,
    ),
    Metric(
        "velocity_error_mm_s",
        "mm/s",
        "Norm of the error of the origin's linear velocity.",
        group="velocity",
    ),
    Metric(
        "angular_velocity_error_deg_s",
        "deg/s",
        "Norm of the error of the angular velocity, in camera axes.",
        group="velocity",
    ),
    Metric("nees", "", _NEES.format(what="the pose"), group="covariance", better="neither", spoken="NEES"),
    *(_inside("the pose", percent) for percent in (50, 90)),
    Metric(
        "velocity_nees",
        "",
        _NEES.format(what="the velocity"),
        group="covariance",
        better="neither",
        spoken="velocity NEES",
    ),
    *(_inside("the velocity", percent, "velocity_") for percent in (50, 90)),
    _honesty(
        "frames_wrong",
        f"Share of the frames with ground truth that are wrong ({_WRONG}), including lost frames.",
        "wrong frames",
    ),
    _honesty(
        "frames_far_tracked",
        f"Share of the frames with ground truth that are far off ({_FAR}) but not marked lost.",
        "frames far off, not lost",
    ),
    _honesty("frames_right_lost", "Share of the correct frames that are marked lost.", "correct frames lost"),
    _honesty(
        "confidence_roc_area",
        "Area under the ROC curve of the confidence: probability that a correct frame has a higher "
        "confidence than a wrong frame, ties counting half; 0.5 is chance level.",
        "confidence ROC area",
        better="higher",
    ),
    _honesty(
        "confidence_brier_score",
        "Mean squared difference between the confidence and the outcome (1 correct, 0 wrong); a constant "
        "confidence of 0.5 scores 0.25.",
        "confidence Brier score",
    ),
    _honesty(
        "confidence_calibration_error",
        "Expected calibration error: mean difference between the confidence and the share of correct "
        "frames over ten confidence bins, weighted by their number of frames.",
        "confidence calibration error",
    ),
    Metric(
        "cost_mm", "mm", "Cost of the estimate against the image, as stored by the run.", group="consistency"
    ),
    Metric(
        "residual_mm",
        "mm",
        "Mean absolute difference of rendered and observed depth, over pixels of both the rendered hand and "
        "the hand segmented around it.",
        group="consistency",
        needs_depth=True,
    ),
    Metric(
        "region_overlap",
        "",
        "Intersection over union of the pixels of the rendered and the observed hand.",
        group="consistency",
        better="higher",
        needs_depth=True,
    ),
    Metric(
        "jitter_mm",
        "mm",
        "Second difference of the points over three frames divided by sqrt(6), mean over the points.",
        group="consistency",
    ),
    Metric("gaps", "", "Number of gaps: intervals with missing frames.", group="consistency", scalar=True),
    Metric(
        "largest_gap_s",
        "s",
        "Longest interval between consecutive estimates.",
        group="consistency",
        scalar=True,
    ),
    Metric("status_changes", "", "Number of status changes.", group="consistency", scalar=True),
    Metric("confidence", "", "Confidence of the estimates, 0 to 1.", group="run", better="higher"),
    Metric("ms_per_frame", "ms", "Processing time per frame.", group="run", spoken="time per frame"),
    Metric(
        "frames_per_s",
        "1/s",
        "Number of frames divided by their total processing time.",
        group="run",
        better="higher",
        scalar=True,
        spoken="frame rate",
    ),
    Metric(
        "evaluations",
        "",
        "Number of poses evaluated against the image per frame.",
        group="run",
        spoken="poses evaluated",
    ),
    Metric("particles", "", "Number of particles.", group="run", better="neither", scalar=True),
    Metric(
        "ess",
        "",
        "Effective sample size of the particle weights before resampling.",
        group="run",
        better="higher",
        spoken="effective sample size",
    ),
    Metric(
        "resampling_rate",
        "",
        "Share of the frames in which the particles were resampled.",
        group="run",
        better="neither",
        scalar=True,
    ),
)
"""Metrics of every subject."""


@cache
def _catalogue(kinds: tuple[SubjectKind, ...]) -> dict[str, Metric]:

    every = dict.fromkeys((*GENERAL, *(own for kind in kinds for own in kind.metrics)))
    return {m.name: m for group in GROUP_TITLES for m in every if m.group == group}


def catalogue() -> dict[str, Metric]:
    """Return all metrics by name, in table order, including those of kinds registered in ``KINDS`` later."""
    return _catalogue(tuple(KINDS.values()))


CATALOGUE = tuple(catalogue().values())
"""All metrics of the built-in kinds of subjects."""


@dataclass(frozen=True)
class Address:
    """Parsed address of a metric value; ``part`` is None for the whole, ``statistic`` None if not given."""

    metric: Metric
    part: str | None
    statistic: str | None

    @property
    def base(self) -> str:
        """The address without statistic: a key of ``Evaluation.metrics``."""
        return self.metric.name if self.part is None else f"{self.metric.name}.{self.part}"


def place_of(address: str) -> int:
    """Return the catalogue index of an address's metric, for sorting; unknown metrics come last."""
    names = list(catalogue())
    name = address.split(".")[0]
    return names.index(name) if name in names else len(names)


def metric_of(address: str) -> Metric:
    """Return the metric of an address, with or without part and statistic.

    Raises:
        UsageError: unknown metric; the hint lists the nearest and all known names.
    """
    name = address.split(".")[0]
    known = catalogue()
    if name not in known:
        raise UsageError(f"unknown metric '{name}'", hint=_known(name, known))
    return known[name]


def is_pooled(address: str) -> bool:
    """Whether an address is pooled over results. Of parts, only shares and counts are."""
    metric = metric_of(address)
    return metric.pooled if metric.scalar else "." not in address


def label_and_unit(address: str) -> tuple[str, str]:
    """Return the display name and the unit of an address: ``joint error, index tip`` and ``mm``."""
    metric, part = metric_of(address), address.partition(".")[2]
    return (f"{metric.label}, {part.replace('_', ' ')}" if part else metric.label), metric.unit


def split_address(address: str) -> Address:
    """Parse ``name[.part][.statistic]``.

    The points of a head depend on the result, so any point name is accepted; the caller must check whether
    an evaluation has it.

    Raises:
        UsageError: unknown metric, part or statistic; the hint lists the nearest and all known names.
    """
    metric = metric_of(address)
    rest = address.split(".")[1:]
    # A trailing statistic name is always parsed as a statistic, never as a part.
    statistic = rest.pop() if rest and not metric.scalar and rest[-1] in STATISTIC_NAMES else None
    part = rest[0] if rest else None
    kinds = [kind for kind in KINDS.values() if is_measured(metric, kind)]
    known = [name for kind in kinds for name in kind.part_names(metric)]
    if len(rest) > 1 or not (part is None or part in known or metric.part == "point"):
        statistics = () if metric.scalar else STATISTIC_NAMES
        expected = _known(rest[-1], [*statistics, *dict.fromkeys(known)])
        wrong = address.removeprefix(f"{metric.name}.")
        raise UsageError(f"metric '{metric.name}' has no '{wrong}'", hint=expected)
    return Address(metric, part, statistic)


def addresses(
    subject: str, point_names: Sequence[str] = (), shape_names: Sequence[str] = ()
) -> tuple[str, ...]:
    """Return all addresses without statistic that an evaluation of a subject can have, in table order.

    Args:
        subject: key of ``KINDS``.
        point_names: names of the points; defaults to those of the built-in model.
        shape_names: names of the shape entries; defaults likewise.
    """
    kind = KINDS[subject]
    found: list[str] = []
    for metric in catalogue().values():
        if is_measured(metric, kind):
            parts = kind.part_names(metric, point_names, shape_names)
            found += [metric.name, *(f"{metric.name}.{part}" for part in parts)]
    return tuple(found)


def is_measured(metric: Metric, kind: SubjectKind) -> bool:
    """Whether a metric applies to a kind of subject."""
    if metric in kind.metrics:
        return True
    lacking = (metric.needs_depth and kind.compare_images is None) or (
        metric.group == "honesty" and not kind.right
    )
    return metric in GENERAL and not lacking


def _known(name: str, known: Iterable[str]) -> str:
    """Return a hint with the nearest name, if any, and all known names."""
    names = list(known)
    if not names:
        return "it is a single number without parts or statistics"
    everything = f"known: {', '.join(sorted(names))}"
    return " ".join(dict.fromkeys((nearest_name(name, names), everything)))


# Key metrics, and lookup of values


# Available for every subject, including unknown ones.
_ALWAYS = ("coverage",)


def key_figures(subject: str) -> tuple[str, ...]:
    """Return the addresses that summarise track quality; regressions are tested on these."""
    return KINDS[subject].key_figures if subject in KINDS else _ALWAYS


def studied_figures(subject: str) -> tuple[str, ...]:
    """Return the addresses that groups of results are compared by."""
    return (*key_figures(subject), *(KINDS[subject].studied_figures if subject in KINDS else ()))


class Measured(Protocol):
    """An evaluated result, or a pool of results."""

    @property
    def name(self) -> str:
        """Display name."""

    @property
    def subject(self) -> str:
        """Kind of subject, a key of ``KINDS``."""

    @property
    def coverage(self) -> Coverage:
        """Frame counts."""

    @property
    def metrics(self) -> Mapping[str, Value]:
        """Values by address without statistic."""

    @property
    def absent(self) -> Mapping[str, str]:
        """Reasons for missing values, by address."""


@dataclass(frozen=True)
class Figure:
    """A finite metric value, or None and the reason why it is missing."""

    value: float | None
    reason: str = ""


def figure_of(evaluation: Measured, address: Address | str) -> Figure:
    """Return the value at a full address, such as ``joint_error_mm.mean`` or ``coverage``.

    Raises:
        UsageError: unknown metric, part or statistic.
    """
    address = split_address(address) if isinstance(address, str) else address
    reason = _why_not(evaluation, address)
    if reason:
        return Figure(None, reason)
    measured = evaluation.metrics[address.base]
    value = getattr(measured, address.statistic or "") if isinstance(measured, Statistics) else measured
    if not math.isfinite(value):
        return Figure(None, f"the value is {value}")
    return Figure(float(value))


def _why_not(evaluation: Measured, address: Address) -> str:
    """Return why a value is missing; empty if it exists."""
    if not evaluation.coverage.frames:
        return "the result has no estimates"
    if not is_measured(address.metric, KINDS[evaluation.subject]):
        return f"not a {evaluation.subject} metric"
    if address.base in evaluation.metrics:
        return ""
    return evaluation.absent.get(address.base) or evaluation.absent.get(address.metric.name, "not measured")
