"""Regression test against the key figures of an earlier JSON report."""

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
"""Absolute tolerance of errors, mm or deg; smaller differences are rounding, not regressions."""
MISSING = "result of the baseline is missing; if it was removed on purpose, write a new baseline"
COMPARED_OPTIONS = ("tolerance_ms", "time_offset_s", "align", "joint_offsets")


class _Stored(BaseModel):
    """Part of a stored report; unknown keys are ignored."""

    model_config = ConfigDict(frozen=True, extra="ignore")


class StoredCoverage(_Stored):
    """Frame counts of a stored report."""

    frames: int
    has_truth: bool
    missed: int = 0
    tracked: int = 0
    tracked_and_matched: int = 0


class StoredFigures(_Stored):
    """Metric values of a result or pool in a stored report."""

    name: str
    subject: str
    coverage: StoredCoverage
    metrics: dict[str, dict[str, Any]]

    def figure(self, address: Address) -> float | None:
        """Return a value; None if it is missing or not finite."""
        return _number(self.metrics.get(address.base, {}).get(address.statistic or "value"))


def _number(value: Any) -> float | None:
    """Return the value if it is a finite number, else None."""
    try:
        known = isinstance(value, int | float) and not isinstance(value, bool)
        number = float(value) if known else math.nan
    except OverflowError:  # integers in JSON are unbounded
        return None
    return number if math.isfinite(number) else None


class StoredPool(StoredFigures):
    """A pool in a stored report."""

    results: tuple[str, ...] = ()


class Format(_Stored):
    """The format field of a stored report, checked before the rest."""

    format: str


class StoredReport(_Stored):
    """A JSON report of ``posetrack eval``, as far as the comparison needs it."""

    options: dict[str, Any] = {}
    results: tuple[StoredFigures, ...]
    pooled: tuple[StoredPool, ...] = ()


@dataclass(frozen=True)
class BaselineCheck:
    """Outcome of a comparison with a baseline.

    Attributes:
        outcomes: outcomes, as for gates.
        notes: remarks that are not failures.
        matched: values of the baseline, by the name of the current result or pool.
    """

    outcomes: tuple[GateOutcome, ...]
    notes: tuple[str, ...]
    matched: Mapping[str, StoredFigures] = field(default_factory=dict)


def read_baseline(path: Path) -> StoredReport:
    """Read a JSON report of ``posetrack eval``.

    Raises:
        UsageError: the file cannot be read, is not a report, or has another format.
    """
    hint = "write a baseline with posetrack eval --json"
    try:
        content = read_input(path, limits.REPORT_BYTES)
    except OSError as error:
        raise UsageError("baseline cannot be read", where=path, found=error.strerror or error) from error
    try:
        found = Format.model_validate_json(content).format
        if found != FORMAT:
            raise UsageError(
                "unsupported format of the baseline", where=path, found=found, expected=FORMAT, hint=hint
            )
        return StoredReport.model_validate_json(content)
    except ValidationError as error:
        raise UsageError("not an evaluation report", where=path, found=_first(error), hint=hint) from error


def check_baseline(
    baseline: StoredReport,
    evaluations: Sequence[Evaluation],
    tolerance: float,
    options: dict[str, Any] | None = None,
    pools: Sequence[Pool] = (),
) -> BaselineCheck:
    """Compare the key figures (``catalogue.key_figures``) of each result with those of the same name.

    A value fails if it is worse by more than the tolerance: an error e above e_0 (1 + tolerance) + 0.01 mm or
    deg, a share below p_0 - tolerance. A value that only the baseline has fails, and so does a result for
    which the baseline has no key figures. Speed is not compared, as machines differ. A single result is
    compared with a single result of the baseline even if their names differ.

    With several results, new ones are noted and missing ones fail; if none is in the baseline, all fail.
    Pooled values are compared with those of the baseline if both pool the same results, else means and
    coverage over the common results.

    Args:
        baseline: the earlier report.
        evaluations: current results.
        tolerance: relative tolerance, 0.05 for 5 %.
        options: current evaluation options; differences to the baseline are noted.
        pools: current pools.
    """
    outcomes: list[GateOutcome] = []
    notes = list(_options_notes(baseline.options, options or {}))
    matched = _partners(baseline, evaluations)
    for one in evaluations:
        if one.name not in matched:
            continue
        judged = [check_gate(gate, one) for gate in _gates(matched[one.name], tolerance)]
        outcomes += judged or [_unjudged(one.name, "the baseline has none of the key figures")]
        notes += _notes(matched[one.name], one)
    new = [one.name for one in evaluations if one.name not in matched]
    known = [stored.name for stored in baseline.results]
    if new and not (matched and len(evaluations) > 1):
        reason = f"no result with this name in the baseline, which has: {some_names(known) or 'none'}"
        outcomes += [_unjudged(name, reason) for name in new]
    elif new:
        plural = "" if len(new) == 1 else "s"
        notes.append(f"{len(new)} new result{plural}, not compared: {some_names(new)}")
    if len(evaluations) > 1 and matched:
        missing = [name for name in dict.fromkeys(known) if name not in matched]
        outcomes += [_unjudged(name, MISSING) for name in missing]
    before: dict[str, StoredFigures] = dict(matched)
    for pool in pools:
        check = _judge_pool(baseline, pool, evaluations, before, tolerance)
        outcomes += check.outcomes
        notes += check.notes
        before |= check.matched
    return BaselineCheck(tuple(outcomes), tuple(notes), before)


def _unjudged(name: str, reason: str) -> GateOutcome:
    return GateOutcome("baseline", name, None, True, reason, "baseline")


def _partners(baseline: StoredReport, evaluations: Sequence[Evaluation]) -> dict[str, StoredFigures]:
    """Return the stored results that correspond to current ones, by name."""
    # File names of single results often differ between runs, for example by a date.
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
    # Shares get an absolute tolerance: relative to a share near 1 and near 0 it would mean different things.
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
    matched: Mapping[str, StoredFigures],
    tolerance: float,
) -> BaselineCheck:
    """Compare the values of a pool."""
    if not pool.has_pooled_values:
        return BaselineCheck((), ())
    members = set(pool.results)
    for stored in baseline.pooled:
        same = stored.subject == pool.subject and set(stored.results) == members
        gates = list(_gates(stored, tolerance, pooled=True)) if same else []
        if len(gates) > 1:  # older reports pool nothing but coverage
            return BaselineCheck(tuple(check_gate(gate, pool) for gate in gates), (), {pool.name: stored})
    common = [one for one in evaluations if one.name in members and one.name in matched]
    if not common:
        return BaselineCheck((), ())
    outcomes = tuple(_judge_common(pool, common, [matched[one.name] for one in common], tolerance))
    note = f"{pool.name}: compared by means and coverage over the {len(common)} results in the baseline"
    return BaselineCheck(outcomes, (note,) if outcomes else ())


def _judge_common(
    pool: Pool, now: Sequence[Evaluation], then: Sequence[StoredFigures], tolerance: float
) -> Iterator[GateOutcome]:
    """Compare the values that follow from those of single results: coverage, and means by count."""
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
    """Return the mean of means weighted by counts; None if one is missing."""
    known = [(mean, count) for mean, count in figures if mean is not None and count is not None and count > 0]
    total = sum(count for _, count in known)
    if len(known) < len(figures) or not math.isfinite(total):
        return None
    return sum(mean * (count / total) for mean, count in known)


def _share(members: Sequence[Coverage | StoredCoverage]) -> float | None:
    """Return the coverage over all members; None if no frame was expected."""
    due = sum(one.frames + one.missed for one in members)
    truth = all(one.has_truth for one in members)
    good = sum(one.tracked_and_matched if truth else one.tracked for one in members)
    try:
        return good / due if due > 0 else None
    except OverflowError:
        return None


def _notes(stored: StoredFigures, evaluation: Evaluation) -> Iterator[str]:
    """Yield differences that limit the comparison."""
    name, now, then = evaluation.name, evaluation.coverage, stored.coverage
    if now.frames != then.frames:
        yield f"{name}: {now.frames} frames, {then.frames} in the baseline"
    if now.has_truth and not then.has_truth:
        yield f"{name}: the baseline was evaluated without ground truth"
    figures = key_figures(evaluation.subject)
    fresh = [f for f in figures if figure_of(evaluation, f).value is not None]
    missing = [f for f in fresh if stored.figure(split_address(f)) is None]
    if missing:
        yield f"{name}: not compared, missing in the baseline: {', '.join(missing)}"


def _options_notes(then: dict[str, Any], now: dict[str, Any]) -> Iterator[str]:
    for key in COMPARED_OPTIONS:
        if key in then and key in now and then[key] != now[key]:
            yield f"{key} is {now[key]}, {then[key]} in the baseline"


def _first(error: ValidationError) -> str:
    problem = error.errors(include_url=False)[0]
    place = ".".join(str(part) for part in problem["loc"])
    return f"{place}: {problem['msg']}" if place else str(problem["msg"])
