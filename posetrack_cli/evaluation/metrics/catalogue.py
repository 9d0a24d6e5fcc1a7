"""The catalogue of metrics: name, unit, meaning. Tables, gates, baselines and reports read them from here.

An address is ``name[.part][.statistic]``: ``joint_error_mm.index_tip.p95``, ``coverage``. Results are
measured under addresses without statistic (``Evaluation.metrics``).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

from posetrack_cli.errors import UsageError, nearest_name
from posetrack_cli.evaluation.statistics import STATISTIC_NAMES
from posetrack_cli.hand.anatomy import ANGLE_NAMES, FINGERS, JOINT_NAMES

Better: TypeAlias = Literal["lower", "higher", "neither"]
Subjects: TypeAlias = tuple[str, ...]
PartKind: TypeAlias = Literal["joint", "finger", "angle", "point", "state"]
Group: TypeAlias = Literal["coverage", "accuracy", "velocity", "covariance", "consistency", "run"]

GROUP_TITLES: dict[Group, str] = {
    "coverage": "Coverage",
    "accuracy": "Error against truth",
    "velocity": "Velocity error against truth",
    "covariance": "Stated covariance against truth",
    "consistency": "Self-consistency, without truth",
    "run": "Run",
}
"""The groups in the order of every table."""

_AXES = ("x", "y", "z", "about_x", "about_y", "about_z")
STATE_PARTS: dict[str, tuple[str, ...]] = {
    "hand": ("position", "rotation", "angles", *_AXES, *ANGLE_NAMES),
    "head": ("position", "rotation", *_AXES),
}
"""Parts of the state that the covariance metrics tell apart, down to its single entries."""

HEAD_POSE = ("x_mm", "y_mm", "z_mm", "roll_deg", "pitch_deg", "yaw_deg")
"""Columns of the thesis's tables 4.1-4.3, each as mean and standard deviation."""

WITHIN_MM = (10, 20, 30, 40, 50, 80)
"""Thresholds D of the metrics ``frames_within_<D>mm`` and ``frames_mean_within_<D>mm``."""

HAND: Subjects = ("hand",)
HEAD: Subjects = ("head",)
BOTH: Subjects = ("hand", "head")


@dataclass(frozen=True)
class Metric:
    """What a figure means.

    Attributes:
        name: first word of its address; ends in its unit where it has one.
        unit: mm, deg, s, ...; empty for counts and shares.
        meaning: one sentence.
        better: which way an improvement goes; ``neither`` where the figure has a target or none at all.
        group: where tables show it.
        subjects: what it is defined for.
        part: kind of the parts that it is told for besides the whole; None for none.
        scalar: one number; otherwise ``Statistics``.
    """

    name: str
    unit: str
    meaning: str
    better: Better
    group: Group
    subjects: Subjects = BOTH
    part: PartKind | None = None
    scalar: bool = False

    def part_names(
        self, subject: str, point_names: Sequence[str] = (), shape_names: Sequence[str] = ()
    ) -> tuple[str, ...]:
        """The parts for a subject with these points and shape entries; of a hand by default our own."""
        hand = subject == "hand"
        points = tuple(point_names) or (JOINT_NAMES if hand else ())
        angles = tuple(shape_names) or (ANGLE_NAMES if hand else ())
        return {
            None: (),
            "joint": points,
            "point": points,
            "finger": FINGERS,
            "angle": angles,
            "state": STATE_PARTS.get(subject, ()),
        }[self.part]


def _number(name: str, group: Group, better: Better, meaning: str, unit: str = "") -> Metric:
    return Metric(name, unit, meaning, better, group, scalar=True)


def _error(
    name: str,
    unit: str,
    subjects: Subjects,
    meaning: str,
    part: PartKind | None = None,
    group: Group = "accuracy",
) -> Metric:
    return Metric(name, unit, meaning, "lower", group, subjects, part)


def _within(threshold_mm: int, which: Literal["largest", "mean"] = "largest") -> Metric:
    meaning = (
        f"Share of the frames with truth, those that the result missed included, whose {which} joint error "
        f"is below {threshold_mm} mm."
    )
    name = f"frames_{'mean_' if which == 'mean' else ''}within_{threshold_mm}mm"
    return Metric(name, "", meaning, "higher", "accuracy", HAND, scalar=True)


def _bias(axis: str, meaning: str) -> Metric:
    better: Better = "neither" if axis else "lower"
    name = f"joint_bias_{f'{axis}_' if axis else ''}mm"
    return Metric(name, "mm", meaning, better, "accuracy", HAND, "joint", scalar=True)


_PALM_AXES = {
    "x": "a right hand's thumb ahead",
    "y": "the wrist ahead",
    "z": "the back of the hand ahead",
}

_NEES = (
    "Squared error in stated standard deviations, summed over {what}: 21 entries for a hand, 6 for a head; "
    "a consistent filter has a mean of that number, a larger one means overconfidence."
)
_INSIDE = (
    "Share of the entries of {what} whose true value lies within +-1.645 stated standard deviations; "
    "a consistent filter with Gaussian errors has 0.9."
)

CATALOGUE: tuple[Metric, ...] = (
    _number(
        "coverage",
        "coverage",
        "higher",
        "Share of the frames due that are tracked and have a truth; without truth the share that is tracked.",
    ),
    _number("frames", "coverage", "neither", "Estimates in the result."),
    _number("tracked", "coverage", "neither", "Estimates that are not lost."),
    _number("lost", "coverage", "lower", "Estimates whose status is lost; their errors count all the same."),
    _number("reinitialised", "coverage", "lower", "Estimates where the track was found anew."),
    _number(
        "matched", "coverage", "neither", "Estimates with a truth at their stamp: errors are over these."
    ),
    _number("unmatched", "coverage", "lower", "Estimates without a truth at their stamp."),
    _number("missed", "coverage", "lower", "Frames that the run left out though there is a truth for them."),
    _number(
        "truth_outside",
        "coverage",
        "neither",
        "Truths before the result's first or after its last estimate; not counted against it.",
    ),
    _error(
        "joint_error_mm",
        "mm",
        HAND,
        "Distance between an estimated and the true joint, over frames and joints, lost frames included.",
        "joint",
    ),
    _error("joint_error_tracked_mm", "mm", HAND, "Joint error over the frames that are not lost."),
    _error(
        "finger_error_mm",
        "mm",
        HAND,
        "Joint error over the joints of one finger, or of all five: every joint but the wrist.",
        "finger",
    ),
    _error("fingertip_error_mm", "mm", HAND, "Joint error over the fingertips."),
    _error("largest_joint_error_mm", "mm", HAND, "Largest joint error of a frame, over frames."),
    *(_within(threshold) for threshold in WITHIN_MM),
    *(_within(threshold, "mean") for threshold in WITHIN_MM),
    _bias("", "Length of a joint's mean error vector where tracked, over all joints the mean length."),
    *(
        _bias(axis, f"Mean of the joints' errors along the palm's {axis} axis, {towards}, where tracked.")
        for axis, towards in _PALM_AXES.items()
    ),
    _error("wrist_position_mm", "mm", HAND, "Distance between the estimated and the true wrist."),
    _error(
        "wrist_rotation_deg",
        "deg",
        HAND,
        "Angle of the rotation between the estimated and the true hand, 0 to 180.",
    ),
    _error(
        "angle_error_deg",
        "deg",
        HAND,
        "Absolute error of the finger angles, over frames and angles.",
        "angle",
    ),
    _error("x_mm", "mm", HEAD, "Absolute error of the head's position along x, right."),
    _error("y_mm", "mm", HEAD, "Absolute error of the head's position along y, down."),
    _error("z_mm", "mm", HEAD, "Absolute error of the head's position along z, the depth."),
    _error("roll_deg", "deg", HEAD, "Absolute error of the head's roll, about z."),
    _error("pitch_deg", "deg", HEAD, "Absolute error of the head's pitch, about x."),
    _error("yaw_deg", "deg", HEAD, "Absolute error of the head's yaw, about y."),
    _error("position_mm", "mm", HEAD, "Distance between the estimated and the true origin of the head."),
    _error(
        "rotation_deg",
        "deg",
        HEAD,
        "Angle of the rotation between the estimated and the true head, 0 to 180.",
    ),
    _error(
        "point_error_mm",
        "mm",
        HEAD,
        "Distance between an estimated and the true feature point in head coordinates, each by its own pose.",
        "point",
    ),
    _error(
        "velocity_error_mm_s",
        "mm/s",
        BOTH,
        "Length of the difference between the estimated and the true velocity of the origin.",
        group="velocity",
    ),
    _error(
        "angular_velocity_error_deg_s",
        "deg/s",
        BOTH,
        "Length of the difference between the estimated and the true angular velocity, in camera axes.",
        group="velocity",
    ),
    _error(
        "angle_velocity_error_deg_s",
        "deg/s",
        HAND,
        "Absolute error of the finger angles' velocities, over frames and angles.",
        "angle",
        "velocity",
    ),
    Metric("nees", "", _NEES.format(what="the pose"), "neither", "covariance"),
    Metric(
        "inside_90", "", _INSIDE.format(what="the pose"), "neither", "covariance", BOTH, "state", scalar=True
    ),
    Metric("velocity_nees", "", _NEES.format(what="the velocity"), "neither", "covariance"),
    Metric(
        "velocity_inside_90",
        "",
        _INSIDE.format(what="the velocity"),
        "neither",
        "covariance",
        BOTH,
        "state",
        scalar=True,
    ),
    Metric("cost_mm", "mm", "The run's own cost of its estimate against the image.", "lower", "consistency"),
    Metric(
        "residual_mm",
        "mm",
        "Mean difference of rendered and observed depth where both have the hand, segmented around it.",
        "lower",
        "consistency",
        HAND,
    ),
    Metric(
        "region_overlap",
        "",
        "Pixels that the rendered and the observed hand share, over those of either.",
        "higher",
        "consistency",
        HAND,
    ),
    Metric(
        "jitter_mm",
        "mm",
        "Mean over points of how far they are off the line between frames before and after, over sqrt(6).",
        "lower",
        "consistency",
    ),
    _number("gaps", "consistency", "lower", "Times that frames are missing between two estimates."),
    _number("largest_gap_s", "consistency", "lower", "Longest time between two estimates.", "s"),
    _number("status_changes", "consistency", "lower", "Times that the status changes."),
    Metric("confidence", "", "Confidence of the estimates, 0 to 1.", "higher", "run"),
    Metric("ms_per_frame", "ms", "Time that a frame took.", "lower", "run"),
    _number("frames_per_s", "run", "higher", "Frames over the time that they took together.", "1/s"),
    Metric("evaluations", "", "Poses a frame whose fit to the image was evaluated.", "lower", "run"),
    _number("particles", "run", "neither", "Particles of the filter."),
    Metric("ess", "", "Effective sample size of the weights before resampling.", "higher", "run"),
    _number("resampling_rate", "run", "neither", "Share of the frames after which particles were resampled."),
)
"""Every metric, in the order of every table."""

_BY_NAME = {metric.name: metric for metric in CATALOGUE}
_PLACES = {metric.name: place for place, metric in enumerate(CATALOGUE)}


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
    return _PLACES.get(address.split(".")[0], len(_PLACES))


def metric_of(address: str) -> Metric:
    """Return the metric that an address, with or without part and statistic, begins with.

    Raises:
        UsageError: there is no such metric; names the nearest and all known ones.
    """
    name = address.split(".")[0]
    if name not in _BY_NAME:
        raise UsageError(f"no metric '{name}'", hint=_known(name, _BY_NAME))
    return _BY_NAME[name]


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
    known = [name for subject in metric.subjects for name in metric.part_names(subject)]
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
        subject: ``hand`` or ``head``.
        point_names: its points; of a hand by default ``JOINT_NAMES``.
        shape_names: its shape entries; of a hand by default ``ANGLE_NAMES``.
    """
    found: list[str] = []
    for metric in CATALOGUE:
        if subject in metric.subjects:
            parts = metric.part_names(subject, point_names, shape_names)
            found += [metric.name, *(f"{metric.name}.{part}" for part in parts)]
    return tuple(found)


def _known(name: str, known: Iterable[str]) -> str:
    """The nearest name if one is near, and all of them."""
    names = list(known)
    if not names:
        return "it is one number"
    everything = f"known: {', '.join(sorted(names))}"
    return " ".join(dict.fromkeys((nearest_name(name, names), everything)))
