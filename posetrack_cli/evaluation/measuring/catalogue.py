"""The catalogue of metrics, and figures by their names."""

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

# The catalogue of metrics: name, unit, meaning. Tables, gates, baselines and reports read them from here.
#
# An address is ``name[.part][.statistic]``: ``joint_error_mm.index_tip.p95``, ``coverage``. Results are
# measured under addresses without statistic (``Evaluation.metrics``). What only one kind of subject has
# stands in ``evaluation.measuring.subjects``.


_NEES = (
    "Squared error in stated standard deviations, summed over {what}: 21 entries for a hand, 6 for a head; "
    "a consistent filter has a mean of that number, a larger one means overconfidence."
)
_INSIDE = (
    "Share of the entries of {what} whose true value lies within +-{width} stated standard deviations; "
    "a consistent filter with Gaussian errors has {share}."
)


def _in_every_kind(limits: str, relation: str, between: str) -> str:
    """What limits of errors are, kind by kind."""
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
        "Share of the frames due that are tracked and have a truth; without truth the share that is tracked.",
        group="coverage",
        better="higher",
        scalar=True,
        pooled=True,
    ),
    Metric(
        "frames", "", "Estimates in the result.", group="coverage", better="neither", scalar=True, pooled=True
    ),
    Metric(
        "tracked",
        "",
        "Estimates that are not lost.",
        group="coverage",
        better="neither",
        scalar=True,
        pooled=True,
    ),
    Metric(
        "lost",
        "",
        "Estimates whose status is lost; their errors count all the same.",
        group="coverage",
        scalar=True,
        pooled=True,
    ),
    Metric(
        "reinitialised",
        "",
        "Estimates where the track was found anew.",
        group="coverage",
        scalar=True,
        pooled=True,
    ),
    Metric(
        "matched",
        "",
        "Estimates with a truth at their stamp: errors are over these.",
        group="coverage",
        better="neither",
        scalar=True,
        pooled=True,
    ),
    Metric(
        "unmatched",
        "",
        "Estimates without a truth at their stamp.",
        group="coverage",
        scalar=True,
        pooled=True,
    ),
    Metric(
        "missed",
        "",
        "Frames that the run left out though there is a truth for them.",
        group="coverage",
        scalar=True,
        pooled=True,
    ),
    Metric(
        "truth_outside",
        "",
        "Truths before the result's first or after its last estimate; not counted against it.",
        group="coverage",
        better="neither",
        scalar=True,
        pooled=True,
    ),
    Metric(
        "velocity_error_mm_s",
        "mm/s",
        "Length of the difference between the estimated and the true velocity of the origin.",
        group="velocity",
    ),
    Metric(
        "angular_velocity_error_deg_s",
        "deg/s",
        "Length of the difference between the estimated and the true angular velocity, in camera axes.",
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
        "frames_wrong", f"Share of the frames with truth that are wrong ({_WRONG}), lost ones included.", ""
    ),
    _honesty(
        "frames_far_tracked",
        f"Share of the frames with truth that are far off ({_FAR}) and yet not lost.",
        "frames far off and not lost",
    ),
    _honesty("frames_right_lost", "Share of the right frames that say they are lost.", "right frames lost"),
    _honesty(
        "confidence_roc_area",
        "Area under the ROC curve of confidence: how probably a right frame has a higher one than a wrong "
        "frame, ties counting half; 0.5 tells nothing apart.",
        "ROC area of confidence",
        better="higher",
    ),
    _honesty(
        "confidence_brier_score",
        "Mean square of confidence minus 1 in right frames and minus 0 in wrong ones; always saying 0.5 "
        "has 0.25.",
        "Brier score of confidence",
    ),
    _honesty(
        "confidence_calibration_error",
        "How far confidence is from the share of frames that are right, averaged over ten bins of "
        "confidence, each by its frames.",
        "calibration error of confidence",
    ),
    Metric("cost_mm", "mm", "The run's own cost of its estimate against the image.", group="consistency"),
    Metric(
        "residual_mm",
        "mm",
        "Mean difference of rendered and observed depth where both have the hand, segmented around it.",
        group="consistency",
        needs_depth=True,
    ),
    Metric(
        "region_overlap",
        "",
        "Pixels that the rendered and the observed hand share, over those of either.",
        group="consistency",
        better="higher",
        needs_depth=True,
    ),
    Metric(
        "jitter_mm",
        "mm",
        "Mean over points of how far they are off the line between frames before and after, over sqrt(6).",
        group="consistency",
    ),
    Metric(
        "gaps", "", "Times that frames are missing between two estimates.", group="consistency", scalar=True
    ),
    Metric("largest_gap_s", "s", "Longest time between two estimates.", group="consistency", scalar=True),
    Metric("status_changes", "", "Times that the status changes.", group="consistency", scalar=True),
    Metric("confidence", "", "Confidence of the estimates, 0 to 1.", group="run", better="higher"),
    Metric("ms_per_frame", "ms", "Time that a frame took.", group="run", spoken="time per frame"),
    Metric(
        "frames_per_s",
        "1/s",
        "Frames over the time that they took together.",
        group="run",
        better="higher",
        scalar=True,
        spoken="frame rate",
    ),
    Metric(
        "evaluations",
        "",
        "Poses a frame whose fit to the image was evaluated.",
        group="run",
        spoken="poses evaluated",
    ),
    Metric("particles", "", "Particles of the filter.", group="run", better="neither", scalar=True),
    Metric(
        "ess",
        "",
        "Effective sample size of the weights before resampling.",
        group="run",
        better="higher",
        spoken="effective sample size",
    ),
    Metric(
        "resampling_rate",
        "",
        "Share of the frames after which particles were resampled.",
        group="run",
        better="neither",
        scalar=True,
    ),
)
"""What every subject is measured by."""


@cache
def _catalogue(kinds: tuple[SubjectKind, ...]) -> dict[str, Metric]:
    """Every metric of some kinds of subjects, by name, in the order of every table."""
    every = dict.fromkeys((*GENERAL, *(own for kind in kinds for own in kind.metrics)))
    return {m.name: m for group in GROUP_TITLES for m in every if m.group == group}


def catalogue() -> dict[str, Metric]:
    """Return every metric by name, in the order of every table; also of kinds that were listed since."""
    return _catalogue(tuple(KINDS.values()))


CATALOGUE = tuple(catalogue().values())
"""Every metric of our own kinds of subjects."""


@dataclass(frozen=True)
class Address:
    """A figure: of which metric, which part of it (None: the whole) and which statistic (None: not said)."""

    metric: Metric
    part: str | None
    statistic: str | None

    @property
    def base(self) -> str:
        """The address without statistic, a key of ``Evaluation.metrics``."""
        return self.metric.name if self.part is None else f"{self.metric.name}.{self.part}"


def place_of(address: str) -> int:
    """Return where in the catalogue an address's metric stands; behind all others if it is none."""
    names = list(catalogue())
    name = address.split(".")[0]
    return names.index(name) if name in names else len(names)


def metric_of(address: str) -> Metric:
    """Return the metric that an address, with or without part and statistic, begins with.

    Raises:
        UsageError: there is no such metric; names the nearest and all known ones.
    """
    name = address.split(".")[0]
    known = catalogue()
    if name not in known:
        raise UsageError(f"no metric '{name}'", hint=_known(name, known))
    return known[name]


def is_pooled(address: str) -> bool:
    """Whether the figures of an address are told of several results together, too; of parts only shares."""
    metric = metric_of(address)
    return metric.pooled if metric.scalar else "." not in address


def label_and_unit(address: str) -> tuple[str, str]:
    """Return what an address is called for readers, and its unit: ``joint error, index tip`` and ``mm``."""
    metric, part = metric_of(address), address.partition(".")[2]
    return (f"{metric.label}, {part.replace('_', ' ')}" if part else metric.label), metric.unit


def split_address(address: str) -> Address:
    """Take ``name[.part][.statistic]`` apart.

    The points of a head are not known before a result is read: any one is accepted here, and it is for the
    caller to see whether an evaluation has it.

    Raises:
        UsageError: no such metric, part or statistic; names the nearest and all known ones.
    """
    metric = metric_of(address)
    rest = address.split(".")[1:]
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
    """Return every address without statistic that a subject's evaluation may have, in the order of tables.

    Args:
        subject: one of ``KINDS``.
        point_names: its points; by default those of our own model, as far as it names them.
        shape_names: its shape entries; likewise.
    """
    kind = KINDS[subject]
    found: list[str] = []
    for metric in catalogue().values():
        if is_measured(metric, kind):
            parts = kind.part_names(metric, point_names, shape_names)
            found += [metric.name, *(f"{metric.name}.{part}" for part in parts)]
    return tuple(found)


def is_measured(metric: Metric, kind: SubjectKind) -> bool:
    """Whether a kind of subject is measured by a metric."""
    if metric in kind.metrics:
        return True
    lacking = (metric.needs_depth and kind.compare_images is None) or (
        metric.group == "honesty" and not kind.right
    )
    return metric in GENERAL and not lacking


def _known(name: str, known: Iterable[str]) -> str:
    """The nearest name if one is near, and all of them."""
    names = list(known)
    if not names:
        return "it is one number"
    everything = f"known: {', '.join(sorted(names))}"
    return " ".join(dict.fromkeys((nearest_name(name, names), everything)))


# One figure of an evaluation, or why it has none; and the figures that results are compared by


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
