"""Everything that ``posetrack eval`` finds out: results measured, compared and judged."""

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
from posetrack_cli.evaluation.judging.rows import MOST_BESIDE, Earlier, ResultSet, Verdict, result_sets
from posetrack_cli.evaluation.measuring.evaluate import EvalOptions, evaluate
from posetrack_cli.evaluation.measuring.evaluation import Evaluation
from posetrack_cli.evaluation.measuring.pooling import Gathered, Pool, PoolKey, make_pools
from posetrack_cli.evaluation.reading.tracks import Track, track_name, unique_names
from posetrack_cli.recording.base import RECORDING_KEY
from posetrack_cli.results.channels import FILTERED, SMOOTHED
from posetrack_cli.results.reader import read_result

Layout: TypeAlias = Literal["columns", "rows"]
T = TypeVar("T")

DEFAULT_TOLERANCE = 0.05
MEASURED = "measured"
"""What a result is that has figures; one that cannot be read fails this gate."""


@dataclass(frozen=True)
class Own:
    """What is asked of one result that is not asked of others.

    Attributes:
        name: what it is called; empty leaves that to its file.
        truth: that it is measured against, in place of the truth for all.
        gates: conditions under which it fails, besides those for all.
    """

    name: str = ""
    truth: Path | None = None
    gates: tuple[Gate, ...] = ()


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
        layout: whether results stand in columns beside each other, where they are compared, or in rows, where
            nothing is kept of each but its figures; by default rows from more than ``rows.MOST_BESIDE``
            recordings on.
        parts: whether the figures of parts are kept in rows, too; those that gates name always are.
        own: what is asked of single results.
        lenient: whether what cannot be measured is a failure and never an error; of many results it is.
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
    own: Mapping[Path, Own] = field(default_factory=dict)
    lenient: bool = False

    @property
    def paths(self) -> tuple[Path, ...]:
        """The files of all results, those of groups included, each once, in the order given."""
        files = (path for paths in self.groups.values() for path in paths)
        return tuple(dict.fromkeys((*self.results, *files)))

    @property
    def every_gate(self) -> tuple[Gate, ...]:
        """Those for all, and those of single results."""
        return (*self.gates, *(gate for own in self.own.values() for gate in own.gates))

    def of(self, path: Path) -> Own:
        """Return what is asked of a result alone."""
        return self.own.get(path, Own())

    def options_of(self, path: Path, which: str) -> EvalOptions:
        """Return how a track of a result is measured."""
        truth = self.of(path).truth or self.options.truth
        return replace(self.options, truth=truth, track=which)

    def kept(self, evaluation: Evaluation, rows: bool) -> Evaluation:
        """Return as much of a result as is asked for; what is pooled of it was gathered before."""
        kept = replace(evaluation, distributions={})
        if rows:
            parts = self.parts or any(gate.address.part is not None for gate in self.every_gate)
            lean = _lean(kept, keep_series=False)
            return lean if parts else _without_parts(lean)
        return kept if self.keep_tracks else _lean(kept, keep_series=not self.groups)


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
        rows: whether the results are rows of tables.
        earlier: figures of the baseline by the name of a result or a pool; None without a baseline.
    """

    evaluations: tuple[Evaluation, ...]
    comparison: Comparison | None
    outcomes: tuple[GateOutcome, ...]
    notes: tuple[str, ...]
    grouped: bool
    beside: tuple[Evaluation, ...] = ()
    pools: tuple[Pool, ...] = ()
    rows: bool = False
    earlier: Mapping[str, Earlier] | None = None

    @cached_property
    def sets(self) -> tuple[ResultSet, ...]:
        """The results as rows."""
        verdict = Verdict(self.outcomes, self.earlier or {}, self.earlier is not None)
        return result_sets(self.evaluations, self.pools, verdict)

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
        PosetrackError: a result or its truth cannot be read (of more than ``rows.MOST_BESIDE`` results: none
            can), no result has a track that is asked for, or a gate names what no result has.
    """
    measuring = _Measuring(request)
    measuring.measure(report)
    evaluations, rows = measuring.evaluations, measuring.rows
    _check_tracks(evaluations, request)
    measured = tuple(evaluations.values())
    groups = _groups(evaluations, request)
    comparison = compare_groups(groups) if groups else None if rows else compare(measured)
    results = set(request.results)
    given = [one for (path, _), one in evaluations.items() if path in results]
    pools = make_pools(given, groups, measuring.gathered)
    outcomes = [*measuring.unread, *check_gates(request.gates, measured, pools)]
    for (path, _), one in evaluations.items():
        outcomes += check_gates(request.of(path).gates, [one])
    notes: tuple[str, ...] = ()
    against: BaselineCheck | None = None
    if request.baseline is not None:
        options = stated_options(request.options)
        against = check_baseline(request.baseline, measured, request.baseline_tolerance, options, pools)
        outcomes, notes = [*outcomes, *against.outcomes], against.notes
    return Assessment(
        evaluations=measured,
        comparison=comparison,
        outcomes=tuple(outcomes),
        notes=notes,
        grouped=bool(groups),
        beside=tuple(measuring.beside),
        pools=pools,
        rows=rows,
        earlier=None if against is None else against.earlier,
    )


class _Measuring:
    """Measures every result; of many it keeps nothing but figures.

    Attributes:
        evaluations: by file and track.
        beside: other tracks of the results, for a page.
        gathered: the values of what is pooled.
        rows: whether results are rows.
        unread: of results that cannot be measured, where there are many: failures that say why.
    """

    def __init__(self, request: Request) -> None:
        self.evaluations: dict[tuple[Path, str], Evaluation] = {}
        self.beside: list[Evaluation] = []
        self.gathered: dict[PoolKey, Gathered] = defaultdict(Gathered)
        self.rows = request.layout == "rows"
        self.unread: list[GateOutcome] = []
        self._request = request
        self._recordings: set[str] = set()
        self._pool_keys = _pool_keys(request)

    def measure(self, report: Callable[[], Any]) -> None:
        """Measure all, in the order given; of many one that cannot be read does not stop the others."""
        request, paths = self._request, self._request.paths
        plain = unique_names(list(paths))
        names = [request.of(path).name or name for path, name in zip(paths, plain, strict=True)]
        first: PosetrackError | None = None
        for path, name in zip(paths, names, strict=True):
            try:
                self._measure(path, name, names)
            except (ResultError, TruthError) as error:
                if len(paths) <= MOST_BESIDE and not request.lenient:
                    raise
                first = first or error
                self.unread.append(GateOutcome(MEASURED, name, None, True, str(error), MEASURED))
            report()
        if first is not None and not self.evaluations and not request.lenient:
            raise first

    def _measure(self, path: Path, name: str, names: Sequence[str]) -> None:
        """Measure the tracks of one result."""
        request = self._request
        several, adds_smoothed = len(request.tracks) > 1, request.page and request.tracks == (FILTERED,)
        for which in read_result(path).tracks if several else request.tracks:
            own = track_name(name, which, names) if several else name
            self._keep(path, evaluate(path, request.options_of(path, which), own))
        if adds_smoothed and not self.rows and SMOOTHED in read_result(path).tracks:
            own = track_name(name, SMOOTHED, names)
            smoothed = evaluate(path, request.options_of(path, SMOOTHED), own)
            self.beside.append(request.kept(smoothed, rows=False))

    def _keep(self, path: Path, one: Evaluation) -> None:
        for key in self._pool_keys(path, one):
            self.gathered[key].add(one)
        self._recordings.add(one.run.get(RECORDING_KEY) or str(path))
        if not self.rows and self._request.layout is None and len(self._recordings) > MOST_BESIDE:
            self.rows, self.beside = True, []
            kept = {place: self._request.kept(other, rows=True) for place, other in self.evaluations.items()}
            self.evaluations = kept
        self.evaluations[path, one.which] = self._request.kept(one, self.rows)


def stated_options(options: EvalOptions) -> dict[str, Any]:
    """Return the options as reports state them, paths as they were given; each result states its track."""
    stated = {key: value for key, value in asdict(options).items() if key != "track"}
    return {key: str(value) if isinstance(value, Path) else value for key, value in stated.items()}


def _check_tracks(evaluations: Mapping[tuple[Path, str], Evaluation], request: Request) -> None:
    """Raise ResultError if several tracks are asked for and no result has more than one."""
    if len(request.tracks) > 1 and evaluations and not any(which == SMOOTHED for _, which in evaluations):
        read_result(next(iter(evaluations))[0]).topic_of_track(SMOOTHED)


def _pool_keys(request: Request) -> Callable[[Path, Evaluation], Iterator[PoolKey]]:
    """Tells what a result of a file is pooled in."""
    results, groups = set(request.results), {name: set(files) for name, files in request.groups.items()}

    def keys(path: Path, one: Evaluation) -> Iterator[PoolKey]:
        if path in results:
            yield one.subject, one.which
        for name, files in groups.items():
            if path in files:
                yield _group_name(request, name, one.which)

    return keys


def _group_name(request: Request, name: str, which: str) -> str:
    """What a group is called; where several tracks are measured each has a group of its own."""
    return name if len(request.tracks) == 1 else track_name(name, which, tuple(request.groups))


def _groups(
    evaluations: Mapping[tuple[Path, str], Evaluation], request: Request
) -> dict[str, list[Evaluation]]:
    """The members of each group; where several tracks are measured each has a group of its own."""
    groups: dict[str, list[Evaluation]] = {}
    for name, files in request.groups.items():
        for which in request.tracks:
            members = [evaluations[path, which] for path in files if (path, which) in evaluations]
            if members:
                groups[_group_name(request, name, which)] = members
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
    lean = replace(evaluation, track=empty, truth=None, pairs=None, track_series={})
    return lean if keep_series else replace(lean, series={}, series_stamp_ns=empty.stamp_ns)


def _without_parts(evaluation: Evaluation) -> Evaluation:
    """Without the figures of single joints, angles and points: a table of rows has none."""

    def wholes(of: Mapping[str, T]) -> dict[str, T]:
        return {base: one for base, one in of.items() if "." not in base}

    return replace(
        evaluation,
        metrics=wholes(evaluation.metrics),
        absent=wholes(evaluation.absent),
        counts=wholes(evaluation.counts),
    )
