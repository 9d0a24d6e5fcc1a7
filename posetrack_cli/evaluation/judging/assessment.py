"""Assessment of results: evaluation, comparison, gates and baseline, as in ``posetrack eval``."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, TypeAlias, TypeVar

import numpy as np

from posetrack_cli.errors import PosetrackError, ResultError, TruthError
from posetrack_cli.evaluation.judging.baseline import BaselineCheck, StoredReport, check_baseline
from posetrack_cli.evaluation.judging.comparing import Comparison, compare, compare_groups
from posetrack_cli.evaluation.judging.gates import Gate, GateOutcome, check_gates
from posetrack_cli.evaluation.judging.rows import MOST_BESIDE, Baseline, GateReport, ResultSet, result_sets
from posetrack_cli.evaluation.measuring.evaluate import EvalOptions, evaluate
from posetrack_cli.evaluation.measuring.evaluation import Evaluation
from posetrack_cli.evaluation.measuring.pooling import Pool, PoolBuilder, PoolKey, make_pools
from posetrack_cli.evaluation.reading.tracks import Track, track_name, unique_names
from posetrack_cli.recording.base import RECORDING_KEY
from posetrack_cli.results.reader import read_result
from posetrack_cli.results.topics import FILTERED, SMOOTHED

Layout: TypeAlias = Literal["columns", "rows"]
T = TypeVar("T")
EvaluationKey: TypeAlias = tuple[Path, str, str]
"""File, track and label of the subject."""

DEFAULT_TOLERANCE = 0.05
MEASURED = "measured"
"""Title of the gate that fails if a result cannot be read."""


@dataclass(frozen=True)
class PerResultOptions:
    """Options of a single result.

    Attributes:
        name: display name; empty to use the file name.
        truth: ground-truth file, instead of that for all results.
        gates: gates, in addition to those for all results.
    """

    name: str = ""
    truth: Path | None = None
    gates: tuple[Gate, ...] = ()


@dataclass(frozen=True)
class Request:
    """Input of an assessment.

    Attributes:
        results: result files.
        groups: result files by group.
        options: evaluation options.
        gates: gates for all results.
        baseline: earlier report to test for regressions against.
        baseline_tolerance: relative tolerance of that test.
        keep_tracks: keep the compared tracks in the evaluations, for reports that plot them. Without them, an
            evaluation takes a few kilobytes per second of recording.
        tracks: tracks to evaluate; if several, those that a result has.
        page: an HTML report will be written, which also shows the smoothed track.
        layout: ``columns`` compares results side by side; ``rows`` keeps only metric values. None selects
            rows for more than ``rows.MOST_BESIDE`` recordings.
        parts: keep metrics of parts in the layout ``rows``; those used by gates are always kept.
        own: options of single results.
        label: label of the subject to evaluate, for results of several; None for all.
        lenient: report unreadable results as failed gates instead of raising an error, even if there are few.
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
    layout: Layout | None = None
    parts: bool = False
    own: Mapping[Path, PerResultOptions] = field(default_factory=dict)
    lenient: bool = False
    label: str | None = None

    @property
    def paths(self) -> tuple[Path, ...]:
        """All result files, including those of groups, without duplicates, in the given order."""
        files = (path for paths in self.groups.values() for path in paths)
        return tuple(dict.fromkeys((*self.results, *files)))

    @property
    def every_gate(self) -> tuple[Gate, ...]:
        """Gates for all results and those of single results."""
        return (*self.gates, *(gate for own in self.own.values() for gate in own.gates))

    def of(self, path: Path) -> PerResultOptions:
        """Return the options of a single result."""
        return self.own.get(path, PerResultOptions())

    def options_of(self, path: Path, which: str, label: str = "") -> EvalOptions:
        """Return the evaluation options for a track of a result."""
        truth = self.of(path).truth or self.options.truth
        return replace(self.options, truth=truth, track=which, label=label)

    def labels_of(self, path: Path) -> tuple[str, ...]:
        """Return the labels of the subjects of a result to evaluate."""
        result = read_result(path)
        return result.labels if self.label is None else result.of(self.label).labels

    def kept(self, evaluation: Evaluation, rows: bool) -> Evaluation:
        """Return an evaluation without the data that the request does not need."""
        kept = replace(evaluation, distributions={})  # already added to the pools
        if rows:
            parts = self.parts or any(gate.address.part is not None for gate in self.every_gate)
            lean = _lean(kept, keep_series=False)
            return lean if parts else _without_parts(lean)
        return kept if self.keep_tracks else _lean(kept, keep_series=not self.groups)


@dataclass(frozen=True, eq=False)
class Assessment:
    """Result of an assessment.

    Attributes:
        evaluations: evaluations of the results, then those of the groups.
        comparison: comparison of the groups, or of results of the same recording; None if there is none.
        outcomes: outcomes of all gates, including those of the baseline.
        notes: limitations of the comparison with the baseline.
        grouped: whether the comparison is between groups.
        other_tracks: evaluations of other tracks, for the HTML report only.
        pools: pools of ungrouped results and of each group.
        rows: whether the layout is ``rows``.
        baseline: baseline values by name of the result or pool; None without a baseline.
    """

    evaluations: tuple[Evaluation, ...]
    comparison: Comparison | None
    outcomes: tuple[GateOutcome, ...]
    notes: tuple[str, ...]
    grouped: bool
    other_tracks: tuple[Evaluation, ...] = ()
    pools: tuple[Pool, ...] = ()
    rows: bool = False
    baseline: Mapping[str, Baseline] | None = None

    @cached_property
    def sets(self) -> tuple[ResultSet, ...]:
        """The results as table rows."""
        gates = GateReport(self.outcomes, self.baseline or {}, self.baseline is not None)
        return result_sets(self.evaluations, self.pools, gates)

    @property
    def failed(self) -> tuple[GateOutcome, ...]:
        """The failed gates, including those that could not be evaluated."""
        return tuple(outcome for outcome in self.outcomes if outcome.failed)

    @property
    def on_page(self) -> tuple[Evaluation, ...]:
        """Evaluations shown in the HTML report: each followed by those of the other tracks of its result."""
        return tuple(
            one
            for main in self.evaluations
            for one in (main, *(b for b in self.other_tracks if (b.path, b.label) == (main.path, main.label)))
        )

    @property
    def page_comparison(self) -> Comparison | None:
        """Comparison shown in the HTML report: of groups, else of all evaluations of the same recording."""
        return compare(self.on_page) if self.other_tracks and not self.grouped else self.comparison


def assess(request: Request, report: Callable[[], Any] = lambda: None) -> Assessment:
    """Evaluate all results, compare them, and apply the gates.

    Args:
        request: results and options.
        report: called after each result.

    Raises:
        PosetrackError: a result or its ground truth cannot be read (with more than ``rows.MOST_BESIDE``
            results: none can be read), no result has a requested track, or a gate names a metric or part that
            no result has.
    """
    measuring = _Measuring(request)
    measuring.measure(report)
    evaluations, rows = measuring.evaluations, measuring.rows
    _check_tracks(evaluations, request)
    measured = tuple(evaluations.values())
    groups = _groups(evaluations, request)
    comparison = compare_groups(groups) if groups else None if rows else compare(measured)
    results = set(request.results)
    given = [one for one in measured if one.path in results]
    pools = make_pools(given, groups, measuring.builders)
    outcomes = [*measuring.unread, *check_gates(request.gates, measured, pools)]
    for one in measured:
        outcomes += check_gates(request.of(one.path).gates, [one])
    notes: tuple[str, ...] = ()
    check: BaselineCheck | None = None
    if request.baseline is not None:
        options = stated_options(request.options)
        check = check_baseline(request.baseline, measured, request.baseline_tolerance, options, pools)
        outcomes, notes = [*outcomes, *check.outcomes], check.notes
    return Assessment(
        evaluations=measured,
        comparison=comparison,
        outcomes=tuple(outcomes),
        notes=notes,
        grouped=bool(groups),
        other_tracks=tuple(measuring.other_tracks),
        pools=pools,
        rows=rows,
        baseline=None if check is None else check.matched,
    )


class _Measuring:
    """Evaluates all results; switches to the layout ``rows`` when there are many recordings.

    Attributes:
        evaluations: evaluations by file, track and label of the subject.
        other_tracks: evaluations of other tracks, for the HTML report.
        builders: accumulated distributions of each pool.
        rows: whether the layout is ``rows``.
        unread: failed gates of unreadable results.
    """

    def __init__(self, request: Request) -> None:
        self.evaluations: dict[EvaluationKey, Evaluation] = {}
        self.other_tracks: list[Evaluation] = []
        self.builders: dict[PoolKey, PoolBuilder] = defaultdict(PoolBuilder)
        self.rows = request.layout == "rows"
        self.unread: list[GateOutcome] = []
        self._request = request
        self._recordings: set[str] = set()
        self._pool_keys = _pool_keys(request)

    def measure(self, report: Callable[[], Any]) -> None:
        """Evaluate all results in the given order; with many, record and skip unreadable ones."""
        request, paths = self._request, self._request.paths
        plain = unique_names(list(paths))
        names = [request.of(path).name or name for path, name in zip(paths, plain, strict=True)]
        first: PosetrackError | None = None
        for path, name in zip(paths, names, strict=True):
            try:
                self._measure(path, name, names)
            except (ResultError, TruthError) as error:
                # With few results an error is clearest; with many, one must not stop the others.
                if len(paths) <= MOST_BESIDE and not request.lenient:
                    raise
                first = first or error
                self.unread.append(GateOutcome(MEASURED, name, None, True, str(error), MEASURED))
            report()
        if first is not None and not self.evaluations and not request.lenient:
            raise first

    def _measure(self, path: Path, name: str, names: Sequence[str]) -> None:
        """Evaluate the tracks of one result."""
        request = self._request
        several, adds_smoothed = len(request.tracks) > 1, request.page and request.tracks == (FILTERED,)
        tracks = read_result(path).tracks if several or adds_smoothed else request.tracks
        for label in request.labels_of(path):
            title = f"{name} {label}" if label else name
            for which in tracks if several else request.tracks:
                own = track_name(title, which, names) if several else title
                self._keep(path, evaluate(path, request.options_of(path, which, label), own))
            if adds_smoothed and not self.rows and SMOOTHED in tracks:
                own = track_name(title, SMOOTHED, names)
                smoothed = evaluate(path, request.options_of(path, SMOOTHED, label), own)
                self.other_tracks.append(request.kept(smoothed, rows=False))

    def _keep(self, path: Path, one: Evaluation) -> None:
        for key in self._pool_keys(path, one):
            self.builders[key].add(one)
        self._recordings.add(one.run.get(RECORDING_KEY) or str(path))
        # Once there are too many recordings, results evaluated so far are also reduced to metric values.
        if not self.rows and self._request.layout is None and len(self._recordings) > MOST_BESIDE:
            self.rows, self.other_tracks = True, []
            kept = {place: self._request.kept(other, rows=True) for place, other in self.evaluations.items()}
            self.evaluations = kept
        self.evaluations[path, one.which, one.label] = self._request.kept(one, self.rows)


def stated_options(options: EvalOptions) -> dict[str, Any]:
    """Return the options for reports, without track and label, which each result states itself."""
    stated = {key: value for key, value in asdict(options).items() if key not in ("track", "label")}
    return {key: str(value) if isinstance(value, Path) else value for key, value in stated.items()}


def _check_tracks(evaluations: Mapping[EvaluationKey, Evaluation], request: Request) -> None:
    """Raise ResultError if several tracks are requested and no result has more than one."""
    if len(request.tracks) > 1 and evaluations and not any(which == SMOOTHED for _, which, _ in evaluations):
        read_result(next(iter(evaluations))[0]).parts[0].topic_of_track(SMOOTHED)


def _pool_keys(request: Request) -> Callable[[Path, Evaluation], Iterator[PoolKey]]:
    """Return a function that yields the keys of the pools of an evaluation."""
    results, groups = set(request.results), {name: set(files) for name, files in request.groups.items()}

    def keys(path: Path, one: Evaluation) -> Iterator[PoolKey]:
        if path in results:
            yield one.subject, one.which
        for name, files in groups.items():
            if path in files:
                yield _group_name(request, name, one.which)

    return keys


def _group_name(request: Request, name: str, which: str) -> str:
    """Return the name of a group; with several tracks, each track forms its own group."""
    return name if len(request.tracks) == 1 else track_name(name, which, tuple(request.groups))


def _groups(evaluations: Mapping[EvaluationKey, Evaluation], request: Request) -> dict[str, list[Evaluation]]:
    """Return the members of each group; with several tracks, each track forms its own group."""
    groups: dict[str, list[Evaluation]] = {}
    for name, files in request.groups.items():
        for which in request.tracks:
            every = [one for one in evaluations.values() if one.which == which]
            members = [one for path in files for one in every if one.path == path]
            if members:
                groups[_group_name(request, name, which)] = members
    return groups


def _lean(evaluation: Evaluation, *, keep_series: bool) -> Evaluation:
    """Return the evaluation without its tracks, and optionally without series."""
    track = evaluation.track
    empty = Track(
        track.name,
        track.subject,
        track.shape_names,
        track.point_names,
        track.point_parents,
        stamp_ns=np.empty(0, dtype=np.int64),
    )
    lean = replace(evaluation, track=empty, truth=None, pairs=None, track_series={})
    return lean if keep_series else replace(lean, series={}, series_stamp_ns=empty.stamp_ns)


def _without_parts(evaluation: Evaluation) -> Evaluation:
    """Return the evaluation without metrics of single joints, angles and points."""

    def wholes(of: Mapping[str, T]) -> dict[str, T]:
        return {base: one for base, one in of.items() if "." not in base}

    return replace(
        evaluation,
        metrics=wholes(evaluation.metrics),
        absent=wholes(evaluation.absent),
        counts=wholes(evaluation.counts),
    )
