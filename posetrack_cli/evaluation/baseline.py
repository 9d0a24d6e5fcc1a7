"""Gates on regression: the figures of an earlier JSON report, with a tolerance."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, ValidationError

from posetrack_cli import limits
from posetrack_cli.errors import UsageError
from posetrack_cli.evaluation.evaluation import Evaluation
from posetrack_cli.evaluation.figures import figure_of, key_figures
from posetrack_cli.evaluation.gates import Gate, GateOutcome, check_gate
from posetrack_cli.evaluation.metrics.catalogue import Address, split_address
from posetrack_cli.evaluation.reports.report_files import FORMAT
from posetrack_cli.files import read_input

FLOOR = 0.01
"""In a figure's own unit, mm or deg: differences as small as this are rounding, not regression."""
COMPARED_OPTIONS = ("tolerance_ms", "time_offset_s", "align", "joint_offsets")


class _Stored(BaseModel):
    """What is needed of a stored report; whatever else it holds is its own matter."""

    model_config = ConfigDict(frozen=True, extra="ignore")


class StoredCoverage(_Stored):
    """Counts that make two evaluations comparable."""

    frames: int
    has_truth: bool


class StoredResult(_Stored):
    """One result of a stored report."""

    name: str
    subject: str
    coverage: StoredCoverage
    metrics: dict[str, dict[str, Any]]

    def figure(self, address: Address) -> float | None:
        """Return a figure, or None where it is absent or was no finite number."""
        value = self.metrics.get(address.base, {}).get(address.statistic or "value")
        return float(value) if isinstance(value, int | float) else None


class Format(_Stored):
    """The layout of a stored report; it says whether the rest can be understood."""

    format: str


class StoredReport(_Stored):
    """A JSON report that was written earlier."""

    options: dict[str, Any] = {}
    results: tuple[StoredResult, ...]


@dataclass(frozen=True)
class BaselineCheck:
    """What a baseline says: outcomes as of gates, and notes that are no failure."""

    outcomes: tuple[GateOutcome, ...]
    notes: tuple[str, ...]


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
) -> BaselineCheck:
    """Compare the key figures (``figures.key_figures``) of each result with those of the same name.

    The only result is compared with the only one of the baseline whatever their names. A figure fails if it
    is worse by more than the tolerance: an error e above e_0 (1 + tolerance) + 0.01 mm or deg, a share below
    p_0 - tolerance. A result that the baseline has not, one without any key figure there, and a figure that
    only the baseline has, cannot be judged and fails. Speed is not compared: machines differ.

    Args:
        baseline: the earlier report.
        evaluations: the results now.
        tolerance: share, 0.05 for 5 %.
        options: what the results were evaluated with; where the baseline's differ a note says so.
    """
    outcomes: list[GateOutcome] = []
    notes = list(_options_notes(baseline.options, options or {}))
    for one in evaluations:
        stored = _partner(baseline, one, len(evaluations))
        if stored is None:
            known = ", ".join(result.name for result in baseline.results) or "none"
            outcomes.append(_unjudged(one, f"the baseline holds no result of this name; it holds: {known}"))
            continue
        judged = [check_gate(gate, one) for gate in _gates(stored, tolerance)]
        outcomes += judged or [_unjudged(one, "the baseline holds none of the key figures")]
        notes += _notes(stored, one)
    return BaselineCheck(tuple(outcomes), tuple(notes))


def _unjudged(evaluation: Evaluation, reason: str) -> GateOutcome:
    return GateOutcome("baseline", evaluation.name, None, True, reason)


def _partner(baseline: StoredReport, evaluation: Evaluation, count: int) -> StoredResult | None:
    if count == len(baseline.results) == 1:
        return baseline.results[0]
    return next((one for one in baseline.results if one.name == evaluation.name), None)


def _gates(stored: StoredResult, tolerance: float) -> Iterator[Gate]:
    for figure in key_figures(stored.subject):
        address = split_address(figure)
        before = stored.figure(address)
        if before is None:
            continue
        if address.metric.better == "higher":
            sign, limit = "<", before - tolerance
        else:
            sign, limit = ">", before * (1 + tolerance) + FLOOR
        text = f"{figure} {sign} {limit:.6g} (baseline {before:.6g}, tolerance {tolerance:g})"
        yield Gate(text, address, sign, limit)


def _notes(stored: StoredResult, evaluation: Evaluation) -> Iterator[str]:
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
