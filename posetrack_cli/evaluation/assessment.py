"""Everything that ``posetrack eval`` finds out: results measured, compared and judged."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from posetrack_cli.evaluation.baseline import StoredReport, check_baseline
from posetrack_cli.evaluation.comparing.comparison import Comparison, compare
from posetrack_cli.evaluation.comparing.groups import compare_groups
from posetrack_cli.evaluation.evaluate import EvalOptions, evaluate
from posetrack_cli.evaluation.evaluation import Evaluation
from posetrack_cli.evaluation.gates import Gate, GateOutcome, check_gates
from posetrack_cli.evaluation.pooling import Pool, make_pools
from posetrack_cli.evaluation.track import Track, track_name, unique_names
from posetrack_cli.results.reader import read_result
from posetrack_cli.results.tracks import FILTERED, SMOOTHED

DEFAULT_TOLERANCE = 0.05


@dataclass(frozen=True)
class Request:
    """What to find out.

    Attributes:
        results: files of results.
        groups: files of results by group; they are measured too.
        options: how results are measured.
        gates: conditions under which a result fails.
        baseline: an earlier report that no figure may be much worse than.
        baseline_tolerance: how much, a share.
        keep_tracks: whether the evaluations keep what was compared, for reports that draw it. Without, an
            evaluation takes some kilobytes per second of recording, so that a hundred fit in memory.
        tracks: of each result; of several, those that it has, beside each other.
        page: whether a page is made, which shows every track of a result, also one that is not asked for.
    """

    results: tuple[Path, ...] = ()
    groups: Mapping[str, tuple[Path, ...]] = field(default_factory=dict)
    options: EvalOptions = field(default_factory=EvalOptions)
    gates: tuple[Gate, ...] = ()
    baseline: StoredReport | None = None
    baseline_tolerance: float = DEFAULT_TOLERANCE
    keep_tracks: bool = False
    tracks: tuple[str, ...] = (FILTERED,)
    page: bool = False

    def measured(self, path: Path, name: str, which: str) -> Evaluation:
        """Measure a track of a result, with as much of it kept as is asked for."""
        evaluation = evaluate(path, replace(self.options, track=which), name)
        return evaluation if self.keep_tracks else _lean(evaluation, keep_series=not self.groups)


@dataclass(frozen=True, eq=False)
class Assessment:
    """What was found out.

    Attributes:
        evaluations: the results', then those of the groups.
        comparison: of the groups, or of several results of one recording; None where there is none.
        outcomes: of every gate and of the baseline.
        notes: what limits the comparison with the baseline.
        grouped: whether the comparison is of groups.
        beside: other tracks of the results, for the page alone.
        pools: the results together, and those of each group.
    """

    evaluations: tuple[Evaluation, ...]
    comparison: Comparison | None
    outcomes: tuple[GateOutcome, ...]
    notes: tuple[str, ...]
    grouped: bool
    beside: tuple[Evaluation, ...] = ()
    pools: tuple[Pool, ...] = ()

    @property
    def failed(self) -> tuple[GateOutcome, ...]:
        """The gates that failed or could not be judged."""
        return tuple(outcome for outcome in self.outcomes if outcome.failed)

    @property
    def on_page(self) -> tuple[Evaluation, ...]:
        """What the page shows: every evaluation, the other tracks behind the one of their result."""
        return tuple(
            one
            for main in self.evaluations
            for one in (main, *(b for b in self.beside if b.path == main.path))
        )

    @property
    def page_comparison(self) -> Comparison | None:
        """What the page compares: the groups, else all that it shows of one recording."""
        return compare(self.on_page) if self.beside and not self.grouped else self.comparison


def assess(request: Request, report: Callable[[], Any] = lambda: None) -> Assessment:
    """Measure every result, compare them, and apply the gates.

    Args:
        request: what to find out.
        report: called after each result.

    Raises:
        PosetrackError: a result or its truth cannot be read, no result has a track that is asked for, or a
            gate names what no result has.
    """
    paths = _every_path(request)
    names = unique_names(list(paths))
    evaluations: dict[tuple[Path, str], Evaluation] = {}
    beside: list[Evaluation] = []
    several, adds_smoothed = len(request.tracks) > 1, request.page and request.tracks == (FILTERED,)
    for path, name in zip(paths, names, strict=True):
        for which in read_result(path).tracks if several else request.tracks:
            own = track_name(name, which, names) if several else name
            evaluations[path, which] = request.measured(path, own, which)
        if adds_smoothed and SMOOTHED in read_result(path).tracks:
            beside.append(request.measured(path, track_name(name, SMOOTHED, names), SMOOTHED))
        report()
    _check_tracks(evaluations, request)
    measured = tuple(evaluations.values())
    groups = _groups(evaluations, request)
    comparison = compare_groups(groups) if groups else compare(measured)
    given = [one for (path, _), one in evaluations.items() if path in request.results]
    pools = make_pools(given, groups)
    outcomes = check_gates(request.gates, measured, pools)
    notes: tuple[str, ...] = ()
    if request.baseline is not None:
        options = stated_options(request.options)
        against = check_baseline(request.baseline, measured, request.baseline_tolerance, options)
        outcomes, notes = [*outcomes, *against.outcomes], against.notes
    return Assessment(measured, comparison, tuple(outcomes), notes, bool(groups), tuple(beside), pools)


def stated_options(options: EvalOptions) -> dict[str, Any]:
    """Return the options as reports state them, paths as they were given; each result states its track."""
    stated = {key: value for key, value in asdict(options).items() if key != "track"}
    return {key: str(value) if isinstance(value, Path) else value for key, value in stated.items()}


def _every_path(request: Request) -> tuple[Path, ...]:
    """Each file once, in the order given."""
    files = (path for paths in request.groups.values() for path in paths)
    return tuple(dict.fromkeys((*request.results, *files)))


def _check_tracks(evaluations: Mapping[tuple[Path, str], Evaluation], request: Request) -> None:
    """Raise ResultError if several tracks are asked for and no result has more than one."""
    if len(request.tracks) > 1 and evaluations and not any(which == SMOOTHED for _, which in evaluations):
        read_result(next(iter(evaluations))[0]).topic_of_track(SMOOTHED)


def _groups(
    evaluations: Mapping[tuple[Path, str], Evaluation], request: Request
) -> dict[str, list[Evaluation]]:
    """The members of each group; where several tracks are measured each has a group of its own."""
    groups: dict[str, list[Evaluation]] = {}
    for name, files in request.groups.items():
        for which in request.tracks:
            members = [evaluations[path, which] for path in files if (path, which) in evaluations]
            if members:
                own = name if len(request.tracks) == 1 else track_name(name, which, tuple(request.groups))
                groups[own] = members
    return groups


def _lean(evaluation: Evaluation, *, keep_series: bool) -> Evaluation:
    """Without the arrays that nothing needs any more; groups are compared by figures, not by frames."""
    track = evaluation.track
    empty = Track(
        track.name,
        track.subject,
        track.shape_names,
        track.point_names,
        track.point_parents,
        stamp_ns=np.empty(0, dtype=np.int64),
    )
    lean = replace(evaluation, track=empty, truth=None, pairs=None)
    return lean if keep_series else replace(lean, series={}, series_stamp_ns=empty.stamp_ns)
