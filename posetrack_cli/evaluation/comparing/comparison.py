"""Results of the same recording beside each other: paired differences, second by second."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from posetrack_cli.evaluation.comparing.paired import Paired, neighbour_correlation, paired, paired_blocks
from posetrack_cli.evaluation.evaluation import Evaluation, Statistics
from posetrack_cli.evaluation.metrics.catalogue import place_of
from posetrack_cli.recording.base import RECORDING_KEY

SECONDS = "one second of a recording"
UNCORRECTED = "p-values are of single tests: with many figures some are small by chance"


@dataclass(frozen=True)
class Difference:
    """How much a figure differs between two results or two groups.

    Attributes:
        figure: address, such as ``joint_error_mm`` or ``joint_error_mm.mean``.
        first, second: names; the difference is second minus first.
        paired: means, difference, interval and test; ``paired.count`` units.
        note: what a reader must know, or empty.
    """

    figure: str
    first: str
    second: str
    paired: Paired
    note: str


@dataclass(frozen=True)
class Comparison:
    """Paired differences, ready to be shown.

    Attributes:
        unit: what one of the pairs is: a second of a recording, or a recording.
        differences: by pair of names, then figure by figure.
        notes: what holds for all of them.
        groups: of groups of results, by group and figure: statistics over its results.
    """

    unit: str
    differences: tuple[Difference, ...]
    notes: tuple[str, ...]
    groups: Mapping[str, Mapping[str, Statistics]] = field(default_factory=dict)


def compare(evaluations: Sequence[Evaluation]) -> Comparison | None:
    """Compare each result with the first one of the same recording, over every figure both have by frame.

    Errors of neighbouring frames are alike, so the unit is a block of one second
    (``evaluation.comparing.blocks``).

    Returns:
        None if no two results are of the same recording.
    """
    by_recording: dict[str, list[Evaluation]] = {}
    for one in evaluations:
        by_recording.setdefault(one.run.get(RECORDING_KEY, ""), []).append(one)
    alone = [name for name, of in by_recording.items() if len(of) < 2 or not name]
    differences = [
        difference
        for recording, (first, *others) in by_recording.items()
        if recording not in alone
        for second in others
        for difference in _differences(first, second)
    ]
    if not differences:
        return None
    names = ", ".join(one.name for recording in alone for one in by_recording[recording])
    notes = [f"no other result of the same recording: {names}"] if names else []
    return Comparison(SECONDS, tuple(differences), (*notes, UNCORRECTED))


def _differences(first: Evaluation, second: Evaluation) -> Iterator[Difference]:
    """Every series that both have, in the catalogue's order."""
    common = [name for name in first.series if name in second.series]
    for figure in sorted(common, key=place_of):
        yield _difference(figure, first, second)


def _difference(figure: str, first: Evaluation, second: Evaluation) -> Difference:
    blocks = paired_blocks(
        first.series_stamp_ns, first.series[figure], second.series_stamp_ns, second.series[figure]
    )
    result = paired(blocks.first, blocks.second)
    notes = [result.note]
    if blocks.left_out:
        notes.append(f"{blocks.left_out} frames without a figure in both are not compared")
    alike = neighbour_correlation(blocks.second - blocks.first)
    if alike:
        notes.append(f"neighbouring seconds are alike (correlation {alike:.2f}): p is too small")
    return Difference(figure, first.name, second.name, result, "; ".join(filter(None, notes)))
