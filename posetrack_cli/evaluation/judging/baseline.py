"""Gates on regression: the figures of an earlier JSON report, with a tolerance."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, ValidationError

from posetrack_cli import limits
from posetrack_cli.errors import UsageError
from posetrack_cli.evaluation.judging.gates import Gate, GateOutcome, check_gate, judge_figure
from posetrack_cli.evaluation.measuring.catalogue import (
    Address,
    Figure,
    figure_of,
    key_figures,
    split_address,
)
from posetrack_cli.evaluation.measuring.evaluation import Evaluation
from posetrack_cli.evaluation.measuring.pooling import Pool
from posetrack_cli.evaluation.reading.tracks import Coverage
from posetrack_cli.evaluation.reports.report_files import FORMAT
from posetrack_cli.evaluation.reports.table import some_names
from posetrack_cli.files import read_input

FLOOR = 0.01
"""In a figure's own unit, mm or deg: differences as small as this are rounding, not regression."""
MISSING = "the baseline holds it, and no result now has this name; a renewed baseline would leave it out"
COMPARED_OPTIONS = ("tolerance_ms", "time_offset_s", "align", "joint_offsets")


class _Stored(BaseModel):
    """What is needed of a stored report; whatever else it holds is its own matter."""

    model_config = ConfigDict(frozen=True, extra="ignore")


class StoredCoverage(_Stored):
    """Counts that make two evaluations comparable, and of which the coverage of several is made."""

    frames: int
    has_truth: bool
    missed: int = 0
    tracked: int = 0
    tracked_and_matched: int = 0


class StoredFigures(_Stored):
    """Figures of a stored report: of a result, or of several that were pooled."""

    name: str
    subject: str
    coverage: StoredCoverage
    metrics: dict[str, dict[str, Any]]

    def figure(self, address: Address) -> float | None:
        """Return a figure, or None where it is absent or was no finite number."""
        return _number(self.metrics.get(address.base, {}).get(address.statistic or "value"))


def _number(value: Any) -> float | None:
    """The value as a finite number, if it is one."""
    try:
        known = isinstance(value, int | float) and not isinstance(value, bool)
        number = float(value) if known else math.nan
    except OverflowError:  # JSON has integers without end
        return None
    return number if math.isfinite(number) else None


class StoredPool(StoredFigures):
    """Several results of a stored report together."""

    results: tuple[str, ...] = ()


class Format(_Stored):
    """The layout of a stored report; it says whether the rest can be understood."""

    format: str


class StoredReport(_Stored):
    """A JSON report that was written earlier."""

    options: dict[str, Any] = {}
    results: tuple[StoredFigures, ...]
    pooled: tuple[StoredPool, ...] = ()


@dataclass(frozen=True)
class BaselineCheck:
    """What a baseline says.

    Attributes:
        outcomes: as of gates.
        notes: what is no failure.
        earlier: the figures of the baseline, by the name of a result or a pool now.
    """

    outcomes: tuple[GateOutcome, ...]
    notes: tuple[str, ...]
    earlier: Mapping[str, StoredFigures] = field(default_factory=dict)


def read_baseline(path: Path) -> StoredReport:
    """Read a JSON report of ``posetrack eval``.

    Raises:
        UsageError: it cannot be read, is no such report, or one of another format.
    """
    hint = "a baseline is written by posetrack eval --json"
    try:
        content = read_input(path, limits.REPORT_BYTES)
    except OSError as error:
        raise UsageError("baseline cannot be read", where=path, found=error.strerror or error) from error
    try:
        found = Format.model_validate_json(content).format
        if found != FORMAT:
            raise UsageError("has another format", where=path, found=found, expected=FORMAT, hint=hint)
        return StoredReport.model_validate_json(content)
    except ValidationError as error:
        raise UsageError(
            "is no report of an evaluation", where=path, found=_first(error), hint=hint
        ) from error


def check_baseline(
    baseline: StoredReport,
    evaluations: Sequence[Evaluation],
    tolerance: float,
    options: dict[str, Any] | None = None,
    pools: Sequence[Pool] = (),
) -> BaselineCheck:
    """Compare the key figures (``figures.key_figures``) of each result with those of the same name.

    The only result is compared with the only one of the baseline whatever their names. A figure fails if it
    is worse by more than the tolerance: an error e above e_0 (1 + tolerance) + 0.01 mm or deg, a share below
    p_0 - tolerance. One without any key figure there, and a figure that only the baseline has, cannot be
    judged and fails. Speed is not compared: machines differ.

    Of several results those that the baseline has not are new, which a note says; those that only it has are
    missing, and fail. Where none is found there all fail. Pooled figures are compared, too: with those of the
    baseline if they are of the same results, else means and coverage over the results that both have.

    Args:
        baseline: the earlier report.
        evaluations: the results now.
        tolerance: share, 0.05 for 5 %.
        options: what the results were evaluated with; where the baseline's differ a note says so.
        pools: the results together.
    """
    outcomes: list[GateOutcome] = []
    notes = list(_options_notes(baseline.options, options or {}))
    earlier = _partners(baseline, evaluations)
    for one in evaluations:
        if one.name not in earlier:
            continue
        judged = [check_gate(gate, one) for gate in _gates(earlier[one.name], tolerance)]
        outcomes += judged or [_unjudged(one.name, "the baseline holds none of the key figures")]
        notes += _notes(earlier[one.name], one)
    new = [one.name for one in evaluations if one.name not in earlier]
    known = [stored.name for stored in baseline.results]
    if new and not (earlier and len(evaluations) > 1):
        reason = f"the baseline holds no result of this name; it holds: {some_names(known) or 'none'}"
        outcomes += [_unjudged(name, reason) for name in new]
    elif new:
        notes.append(f"{_results(new)} new and not compared: {some_names(new)}")
    if len(evaluations) > 1 and earlier:
        missing = [name for name in dict.fromkeys(known) if name not in earlier]
        outcomes += [_unjudged(name, MISSING) for name in missing]
    before: dict[str, StoredFigures] = dict(earlier)
    for pool in pools:
        together = _judge_pool(baseline, pool, evaluations, before, tolerance)
        outcomes += together.outcomes
        notes += together.notes
        before |= together.earlier
    return BaselineCheck(tuple(outcomes), tuple(notes), before)


def _results(names: Sequence[str]) -> str:
    return "1 result is" if len(names) == 1 else f"{len(names)} results are"


def _unjudged(name: str, reason: str) -> GateOutcome:
    return GateOutcome("baseline", name, None, True, reason, "baseline")


def _partners(baseline: StoredReport, evaluations: Sequence[Evaluation]) -> dict[str, StoredFigures]:
    """The stored result of each that has one, by name."""
    if len(evaluations) == len(baseline.results) == 1:
        return {evaluations[0].name: baseline.results[0]}
    stored: dict[str, StoredFigures] = {}
    for one in baseline.results:
        stored.setdefault(one.name, one)
    return {one.name: stored[one.name] for one in evaluations if one.name in stored}


def _gates(stored: StoredFigures, tolerance: float, pooled: bool = False) -> Iterator[Gate]:
    for figure in key_figures(stored.subject):
        before = stored.figure(split_address(figure))
        if before is not None:
            yield _gate(figure, before, tolerance, pooled)


def _gate(figure: str, before: float, tolerance: float, pooled: bool = False) -> Gate:
    address = split_address(figure)
    if address.metric.better == "higher":
        sign, limit = "<", before - tolerance
    else:
        sign, limit = ">", before * (1 + tolerance) + FLOOR
    bare = Gate("", address, sign, limit, pooled)
    text = f"{bare.figure} {sign} {limit:.6g} (baseline {before:.6g}, tolerance {tolerance:g})"
    return replace(bare, text=text, title=f"baseline: {bare.figure}")


def _judge_pool(
    baseline: StoredReport,
    pool: Pool,
    evaluations: Sequence[Evaluation],
    earlier: Mapping[str, StoredFigures],
    tolerance: float,
) -> BaselineCheck:
    """Compare the figures of several results together."""
    if not pool.says_more:
        return BaselineCheck((), ())
    members = set(pool.results)
    for stored in baseline.pooled:
        same = stored.subject == pool.subject and set(stored.results) == members
        gates = list(_gates(stored, tolerance, pooled=True)) if same else []
        if len(gates) > 1:  # coverage alone is of a time when errors were not pooled
            return BaselineCheck(tuple(check_gate(gate, pool) for gate in gates), (), {pool.name: stored})
    common = [one for one in evaluations if one.name in members and one.name in earlier]
    if not common:
        return BaselineCheck((), ())
    outcomes = tuple(_judge_common(pool, common, [earlier[one.name] for one in common], tolerance))
    what = f"means and coverage over the {len(common)} results that the baseline has, too"
    return BaselineCheck(outcomes, (f"{pool.name}: compared are {what}",) if outcomes else ())


def _judge_common(
    pool: Pool, now: Sequence[Evaluation], then: Sequence[StoredFigures], tolerance: float
) -> Iterator[GateOutcome]:
    """Compare what can be made of the figures of single results: means, by their counts, and coverage."""
    for figure in key_figures(pool.subject):
        address = split_address(figure)
        if figure == "coverage":
            before, after = (_share([one.coverage for one in of]) for of in (then, now))
        elif address.statistic == "mean":
            before = _mean([(one.figure(address), one.figure(_count(address))) for one in then])
            after = _mean(
                [(figure_of(one, address).value, figure_of(one, _count(address)).value) for one in now]
            )
        else:
            continue
        if before is not None and after is not None:
            gate = _gate(figure, before, tolerance, pooled=True)
            yield judge_figure(gate, pool.name, Figure(after), len(now))


def _count(address: Address) -> Address:
    return replace(address, statistic="count")


def _mean(figures: Sequence[tuple[float | None, float | None]]) -> float | None:
    """The mean of means, by the counts of their values; None where one has none."""
    known = [(mean, count) for mean, count in figures if mean is not None and count is not None and count > 0]
    total = sum(count for _, count in known)
    if len(known) < len(figures) or not math.isfinite(total):
        return None
    return sum(mean * (count / total) for mean, count in known)


def _share(members: Sequence[Coverage | StoredCoverage]) -> float | None:
    """The coverage of several together, None where nothing was due."""
    due = sum(one.frames + one.missed for one in members)
    truth = all(one.has_truth for one in members)
    good = sum(one.tracked_and_matched if truth else one.tracked for one in members)
    try:
        return good / due if due > 0 else None
    except OverflowError:
        return None


def _notes(stored: StoredFigures, evaluation: Evaluation) -> Iterator[str]:
    """What makes the two less comparable, and what is not compared."""
    name, now, then = evaluation.name, evaluation.coverage, stored.coverage
    if now.frames != then.frames:
        yield f"{name}: {now.frames} frames, the baseline has {then.frames}"
    if now.has_truth and not then.has_truth:
        yield f"{name}: the baseline was evaluated without truth"
    figures = key_figures(evaluation.subject)
    fresh = [f for f in figures if figure_of(evaluation, f).value is not None]
    missing = [f for f in fresh if stored.figure(split_address(f)) is None]
    if missing:
        yield f"{name}: not in the baseline and not compared: {', '.join(missing)}"


def _options_notes(then: dict[str, Any], now: dict[str, Any]) -> Iterator[str]:
    for key in COMPARED_OPTIONS:
        if key in then and key in now and then[key] != now[key]:
            yield f"{key} is {now[key]}, in the baseline {then[key]}"


def _first(error: ValidationError) -> str:
    problem = error.errors(include_url=False)[0]
    place = ".".join(str(part) for part in problem["loc"])
    return f"{place}: {problem['msg']}" if place else str(problem["msg"])
