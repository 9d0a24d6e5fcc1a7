"""Description of a kind of subject for evaluation and reports."""

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
"""Adds metrics against ground truth over the matched frames; the integer is the number of missed frames."""
RemoveOffsets: TypeAlias = Callable[[Result, Matched, OffsetFrame], tuple[Track, JointOffsets | None]]
MeasureOfResult: TypeAlias = Callable[[Measures, Result, Matched], None]
CompareImages: TypeAlias = Callable[[Result, "Recording", str], Mapping[str, FloatArray]]
"""Compares the named track of a result with images: values (N,) by metric, NaN in frames without a value."""


@dataclass(frozen=True, eq=False)
class SubjectKind:
    """A kind of subject.

    Attributes:
        name: name of the subject.
        body: label of the posed body part in the HTML report.
        metrics: metrics of this kind, in addition to those of every subject, in table order.
        measure: computes them.
        parts: names of parts by kind of part (``Metric.part``); ``state`` lists the parts that covariance
            metrics are reported for.
        point_part, shape_part: kinds of part of a result's points and shape entries; empty for none.
        point_metric: metric of the error of single points.
        key_figures: addresses that summarise track quality; regressions are tested on these.
        studied_figures: further addresses that groups of results are compared by.
        lead: metrics at the top of the HTML report.
        readings: metrics shown next to the 3D view.
        right: upper limits of the errors of a correct frame, by metric; empty if not defined. Frames are
            judged if the first metric is known. Confidence is the probability that a frame is correct.
        far: limits above which a frame is far off; the first metric must be the first of ``right``.
        worst_by: metrics that rank the worst frames; the first one that an evaluation has is used.
        measure_of_result: adds metrics that need more of the result than its track, such as the camera; None
            if there are none.
        expressions: names of a result's action numbers, as shares; each has a standard deviation
            ``NAME_sd``. The HTML report starts with them and the head rotation.
        remove_offsets: removes the constant offset of each point from an estimate; None if not supported.
        compare_images: compares with depth images; None if not supported.
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
        """Describe error limits: ``rotation error at most 3 deg and point error at most 5 mm``."""
        metrics = {metric.name: metric for metric in self.metrics}
        labels = {name: f"mean {one.label}" if one.part else one.label for name, one in metrics.items()}
        return between.join(
            f"{labels[name]} {relation} {limit:g} {metrics[name].unit}" for name, limit in limits.items()
        )

    def part_names(
        self, metric: Metric, point_names: Sequence[str] = (), shape_names: Sequence[str] = ()
    ) -> tuple[str, ...]:
        """Return the parts of a metric; names of points and shape entries default to the built-in model's."""
        if metric.part is None:
            return ()
        # Names of a result take precedence, as head points depend on its face model.
        own = {self.point_part: tuple(point_names), self.shape_part: tuple(shape_names)}
        return own.get(metric.part) or self.parts.get(metric.part, ())
