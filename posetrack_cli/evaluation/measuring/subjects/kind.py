"""What measuring and reporting must know of a kind of subject; each kind is stated in a module of its own."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, TypeAlias

from posetrack_cli.arrays import FloatArray
from posetrack_cli.evaluation.measuring.evaluation import Curve
from posetrack_cli.evaluation.measuring.measures import Matched, Measures, Metric
from posetrack_cli.evaluation.reading.alignment import JointOffsets, OffsetFrame
from posetrack_cli.evaluation.reading.tracks import Track
from posetrack_cli.results.reader import Result

if TYPE_CHECKING:
    from posetrack_cli.recording.recording import Recording

Measure: TypeAlias = Callable[[Measures, Matched, int], Curve | None]
"""Adds what is measured of matched frames against truth; the number is that of frames that were missed."""
RemoveOffsets: TypeAlias = Callable[[Result, Matched, OffsetFrame], tuple[Track, JointOffsets | None]]
MeasureOfResult: TypeAlias = Callable[[Measures, Result, Matched], None]
CompareImages: TypeAlias = Callable[[Result, "Recording", str], Mapping[str, FloatArray]]
"""Measures a track of a result, by name, against images: values (N,) by metric, NaN where there is none."""


@dataclass(frozen=True, eq=False)
class SubjectKind:
    """A kind of subject.

    Attributes:
        name: of the subject.
        body: what the page calls the part that the pose is of.
        metrics: of errors against truth, beyond those of every subject, in the order of tables.
        measure: fills them.
        parts: names of parts by the kind of part (``Metric.part``). ``state`` are those that the covariance
            metrics tell apart.
        point_part, shape_part: kinds of part that a result's points and shape entries are; empty for none.
        point_metric: the error of single points.
        key_figures: how good a track is, in a few figures. Regressions are found in these.
        studied_figures: what groups of results are compared by beyond the key figures.
        lead: metrics that a page begins with.
        readings: metrics that a page tells beside the view in space.
        right: the largest errors of a frame that is right, by metric; empty where that is not defined. Frames
            are judged where the first is known; confidence is the probability that they are right.
        far: the errors above which a frame is far off; the first must be the first of ``right``.
        worst_by: those of its metrics that say how bad a frame is; the first counts that an evaluation has.
        measure_of_result: adds metrics that need more of the result than its track, such as its camera; None
            where there are none.
        expressions: those of a result's numbers that say what it does, in shares; each has its deviation as
            ``NAME_sd``. A page of such a subject begins with them, and with how it is turned.
        remove_offsets: takes a constant offset of each point out of an estimate; None where none is meant.
        compare_images: measures against depth images; None where there are none.
    """

    name: str
    body: str
    metrics: tuple[Metric, ...]
    measure: Measure
    parts: Mapping[str, tuple[str, ...]]
    point_part: str
    shape_part: str
    point_metric: str
    key_figures: tuple[str, ...]
    studied_figures: tuple[str, ...]
    lead: tuple[str, ...]
    readings: tuple[str, ...]
    worst_by: tuple[str, ...]
    right: Mapping[str, float] = field(default_factory=dict)
    far: Mapping[str, float] = field(default_factory=dict)
    measure_of_result: MeasureOfResult | None = None
    expressions: tuple[str, ...] = ()
    remove_offsets: RemoveOffsets | None = None
    compare_images: CompareImages | None = None

    def in_words(self, limits: Mapping[str, float], relation: str, between: str) -> str:
        """Say limits of errors: ``rotation error at most 3 deg and point error at most 5 mm``."""
        metrics = {metric.name: metric for metric in self.metrics}
        labels = {name: f"mean {one.label}" if one.part else one.label for name, one in metrics.items()}
        return between.join(
            f"{labels[name]} {relation} {limit:g} {metrics[name].unit}" for name, limit in limits.items()
        )

    def part_names(
        self, metric: Metric, point_names: Sequence[str] = (), shape_names: Sequence[str] = ()
    ) -> tuple[str, ...]:
        """Return the parts of a metric for these points and shape entries, by default our own."""
        if metric.part is None:
            return ()
        own = {self.point_part: tuple(point_names), self.shape_part: tuple(shape_names)}
        return own.get(metric.part) or self.parts.get(metric.part, ())
