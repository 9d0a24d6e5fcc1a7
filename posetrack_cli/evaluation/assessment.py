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
from posetrack_cli.evaluation.result_names import unique_names
from posetrack_cli.evaluation.track import Track

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
    """

    results: tuple[Path, ...] = ()
    groups: Mapping[str, tuple[Path, ...]] = field(default_factory=dict)
    options: EvalOptions = field(default_factory=EvalOptions)
    gates: tuple[Gate, ...] = ()
    baseline: StoredReport | None = None
    baseline_tolerance: float = DEFAULT_TOLERANCE
    keep_tracks: bool = False


@dataclass(frozen=True, eq=False)
class Assessment:
    """What was found out.

    Attributes:
        evaluations: the results', then those of the groups.
        comparison: of the groups, or of several results of one recording; None where there is none.
        outcomes: of every gate and of the baseline.
        notes: what limits the comparison with the baseline.
        grouped: whether the comparison is of groups.
    """

    evaluations: tuple[Evaluation, ...]
    comparison: Comparison | None
    outcomes: tuple[GateOutcome, ...]
    notes: tuple[str, ...]
    grouped: bool

    @property
    def failed(self) -> tuple[GateOutcome, ...]:
        """The gates that failed or could not be judged."""
        return tuple(outcome for outcome in self.outcomes if outcome.failed)


def assess(request: Request, report: Callable[[], Any] = lambda: None) -> Assessment:
    """Measure every result, compare them, and apply the gates.

    Args:
        request: what to find out.
        report: called after each result.

    Raises:
        PosetrackError: a result or its truth cannot be read, or a gate names what no result has.
    """
    paths = _every_path(request)
    evaluations = {
        path: _measured(path, name, request, report)
        for path, name in zip(paths, unique_names(list(paths)), strict=True)
    }
    measured = tuple(evaluations.values())
    groups = {name: [evaluations[path] for path in files] for name, files in request.groups.items()}
    comparison = compare_groups(groups) if groups else compare(measured)
    outcomes = check_gates(request.gates, measured)
    notes: tuple[str, ...] = ()
    if request.baseline is not None:
        options = stated_options(request.options)
        against = check_baseline(request.baseline, measured, request.baseline_tolerance, options)
        outcomes, notes = [*outcomes, *against.outcomes], against.notes
    return Assessment(measured, comparison, tuple(outcomes), notes, bool(groups))


def stated_options(options: EvalOptions) -> dict[str, Any]:
    """Return the options as reports state them, paths as they were given."""
    return {key: str(value) if isinstance(value, Path) else value for key, value in asdict(options).items()}


def _every_path(request: Request) -> tuple[Path, ...]:
    """Each file once, in the order given."""
    files = (path for paths in request.groups.values() for path in paths)
    return tuple(dict.fromkeys((*request.results, *files)))


def _measured(path: Path, name: str, request: Request, report: Callable[[], Any]) -> Evaluation:
    evaluation = evaluate(path, request.options, name)
    report()
    return evaluation if request.keep_tracks else _lean(evaluation, keep_series=not request.groups)


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
