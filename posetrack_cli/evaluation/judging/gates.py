"""Gates: conditions on figures that make an evaluation fail, for continuous integration."""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

from posetrack_cli import limits
from posetrack_cli.errors import PosetrackError, UsageError, nearest_name
from posetrack_cli.evaluation.measuring.catalogue import (
    Address,
    Figure,
    Measured,
    catalogue,
    figure_of,
    is_pooled,
    split_address,
)
from posetrack_cli.evaluation.measuring.evaluation import STATISTIC_NAMES, Evaluation, statistics
from posetrack_cli.evaluation.measuring.pooling import POOLED, Pool
from posetrack_cli.files import read_text

OPERATORS: dict[str, Callable[[float, float], bool]] = {
    ">=": operator.ge,
    "<=": operator.le,
    "==": operator.eq,
    "!=": operator.ne,
    ">": operator.gt,
    "<": operator.lt,
}
"""Longest first, so that ``>=`` is not read as ``>``."""
GRAMMAR = "METRIC[.PART].STATISTIC or METRIC, then one of > >= < <= == !=, then a number"
EXAMPLE = "such as 'joint_error_mm.mean > 10' or 'coverage < 0.99'"
PREFIX = f"{POOLED}."
"""Begins the address of a figure of all results together."""
OVER = re.compile(rf"({'|'.join(STATISTIC_NAMES)}) *\((.*)\)")
"""A statistic over the figures of all results, such as ``p95(joint_error_mm.mean)``."""
CONDITION = re.compile(rf"([^<>=!]+)({'|'.join(OPERATORS)})([^<>=!]+)")


@dataclass(frozen=True)
class Gate:
    """A condition under which an evaluation fails.

    Attributes:
        text: as it is shown.
        address: the figure.
        sign: the comparison, a key of ``OPERATORS``.
        limit: what the figure is compared with.
        pooled: whether it is about the results together, not about each.
        over: the statistic over the figures of the results that it is about, or empty.
        title: what reports of tests call it, the same from run to run, whatever the limit; else the text.
    """

    text: str
    address: Address
    sign: str
    limit: float
    pooled: bool = False
    over: str = ""
    title: str = ""

    @property
    def figure(self) -> str:
        """The full name of the figure."""
        address = self.address
        name = address.base if address.statistic is None else f"{address.base}.{address.statistic}"
        return f"{self.over}({name})" if self.over else f"{PREFIX}{name}" if self.pooled else name


@dataclass(frozen=True)
class GateOutcome:
    """What a gate says about one result.

    Attributes:
        gate: the condition.
        result: the result's name.
        figure: its figure, or None where it cannot be judged.
        failed: whether the condition is true, or cannot be judged.
        reason: why it cannot be judged, else what the figure is.
        title: as of the gate.
    """

    gate: str
    result: str
    figure: float | None
    failed: bool
    reason: str
    title: str = ""

    @property
    def line(self) -> str:
        """One line for a reader of a log."""
        if self.figure is None:
            return f"{self.result}: gate '{self.gate}' cannot be judged: {self.reason}"
        return f"{self.result}: gate '{self.gate}' {'failed' if self.failed else 'passed'}: {self.reason}"


def gates_line(outcomes: Sequence[GateOutcome]) -> str:
    """Return how many gates failed, as every report says it: ``1 of 3 gates failed``; empty without any."""
    failed = sum(one.failed for one in outcomes)
    if failed:
        return f"{failed} of {len(outcomes)} gates failed"
    return f"all {len(outcomes)} gates passed" if outcomes else ""


def parse_gate(text: str) -> Gate:
    """Read a condition ``FIGURE OP NUMBER``; where it is true it has failed.

    A figure is ``METRIC[.PART][.STATISTIC]`` of each result; ``pooled.METRIC[.STATISTIC]`` of the frames of
    all results together; or ``STATISTIC(METRIC[.PART][.STATISTIC])`` of the figures that the results have.

    Raises:
        UsageError: it is no such condition, or names no figure there is.
    """
    match = CONDITION.fullmatch(text.strip())
    if match is None:
        raise UsageError(
            f"'{text.strip()}' is no condition", expected=GRAMMAR, hint=_sign_hint(text) or EXAMPLE
        )
    name, sign, number = (part.strip() for part in match.groups())
    over, inner = _over_results(name)
    pooled = inner.startswith(PREFIX)
    if over and pooled:
        raise UsageError(f"'{inner}' is one figure, not one of each result", expected=f"{over}(METRIC)")
    address = split_address(inner.removeprefix(PREFIX))
    if pooled and not is_pooled(address.base):
        _refuse_pooled(address)
    if address.statistic is None and not address.metric.scalar:
        choices = ", ".join(f"{inner}.{statistic}" for statistic in STATISTIC_NAMES)
        raise UsageError(f"condition '{text.strip()}' does not say which statistic", expected=choices)
    return Gate(f"{name} {sign} {number}", address, sign, _limit(number, text.strip()), pooled, over)


def _over_results(name: str) -> tuple[str, str]:
    """The statistic over results, or nothing, and the name of the figure."""
    if "(" not in name and ")" not in name:
        return "", name
    match = OVER.fullmatch(name)
    if match is None:
        known = ", ".join(f"{statistic}(...)" for statistic in STATISTIC_NAMES)
        raise UsageError(
            f"'{name}' is no figure over results", expected=f"one of {known}", hint="p95(joint_error_mm.mean)"
        )
    return match[1], match[2].strip()


def _refuse_pooled(address: Address) -> NoReturn:
    if address.part is not None and not address.metric.scalar:
        hint = f"{PREFIX}{address.metric.name}, or over results p95({address.base}.mean)"
        raise UsageError(f"parts of '{address.metric.name}' are not pooled over results", hint=hint)
    known = ", ".join(name for name in catalogue() if is_pooled(name))
    raise UsageError(f"'{address.metric.name}' is not pooled over results", expected=f"one of {known}")


def read_gates(path: Path) -> list[Gate]:
    """Read a file of conditions, one a line; what follows a ``#`` is a comment.

    Raises:
        UsageError: it cannot be read, holds no condition, or one of them is none; names the line.
    """
    try:
        lines = read_text(path, limits.TEXT_BYTES, "utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        found = error.strerror if isinstance(error, OSError) else "bytes that are no UTF-8"
        raise UsageError("gates cannot be read", where=path, found=found) from error
    stripped = [(number, line.partition("#")[0].strip()) for number, line in enumerate(lines, 1)]
    gates = [_gate_of_line(path, number, line) for number, line in stripped if line]
    if not gates:
        raise UsageError("holds no gate", where=path, expected="one condition a line", hint=EXAMPLE)
    return gates


def all_gates(conditions: Iterable[str], files: Iterable[Path]) -> tuple[Gate, ...]:
    """Return the gates of conditions and of files of them, in this order.

    Raises:
        UsageError: as of ``parse_gate`` and ``read_gates``.
    """
    every = [parse_gate(text) for text in conditions]
    return (*every, *(gate for path in files for gate in read_gates(path)))


def check_gates(
    gates: Sequence[Gate], evaluations: Sequence[Evaluation], pools: Sequence[Pool] = ()
) -> list[GateOutcome]:
    """Apply every gate to every result, those of pooled figures and those over results to every pool.

    A gate that cannot be judged has failed: its metric is absent or no finite number, the result is empty,
    or its coverage is 0, when only figures of coverage itself say anything.

    Raises:
        UsageError: a gate names a part, such as a feature point, that none of the results has.
    """
    for gate in gates:
        _check_part(gate.address, evaluations)
    by_name = {one.name: one for one in evaluations}
    outcomes: list[GateOutcome] = []
    for gate in gates:
        if gate.over:
            outcomes += [_check_over(gate, one, [by_name[name] for name in one.results]) for one in pools]
        else:
            outcomes += [check_gate(gate, one) for one in (pools if gate.pooled else evaluations)]
    return outcomes


def check_gate(gate: Gate, evaluation: Measured) -> GateOutcome:
    """Apply one gate to one result, or to one pool."""
    return judge_figure(gate, evaluation.name, _judged(evaluation, gate.address))


def _check_over(gate: Gate, pool: Pool, members: Sequence[Evaluation]) -> GateOutcome:
    """Apply a gate to the figures that a pool's results have; none may be without."""
    figures = [_judged(one, gate.address) for one in members]
    lacking = [
        (one.name, figure.reason) for one, figure in zip(members, figures, strict=True) if figure.reason
    ]
    if lacking:
        name, reason = lacking[0]
        more = f", and {len(lacking) - 1} more without it" if len(lacking) > 1 else ""
        return judge_figure(gate, pool.name, Figure(None, f"{name}: {reason}{more}"))
    values = [figure.value for figure in figures if figure.value is not None]
    return judge_figure(gate, pool.name, Figure(float(getattr(statistics(values), gate.over))), len(values))


def judge_figure(gate: Gate, name: str, figure: Figure, results: int = 0) -> GateOutcome:
    """Apply a gate to a figure.

    Args:
        gate: the condition.
        name: whose figure it is.
        figure: or why there is none.
        results: over how many results it is; 0 for that of one or of a pool.
    """
    title = gate.title or gate.text
    if figure.value is None:
        return GateOutcome(gate.text, name, None, True, figure.reason, title)
    failed = OPERATORS[gate.sign](figure.value, gate.limit)
    over = f" over {results} result{'s' * (results > 1)}" if results else ""
    shown = f"{gate.figure}{over} is {shown_figure(figure.value, gate.limit)}"
    return GateOutcome(gate.text, name, figure.value, failed, shown, title)


def shown_figure(value: float, limit: float) -> str:
    """Show a figure in as few digits as keep it apart from what it is compared with."""
    short = f"{value:.4g}"
    return short if value == limit or float(short) != limit else repr(value)


def _judged(evaluation: Measured, address: Address) -> Figure:
    figure = figure_of(evaluation, address)
    if figure.value is not None and address.metric.group != "coverage" and evaluation.coverage.share == 0:
        return Figure(None, "coverage is 0")
    return figure


def _gate_of_line(path: Path, number: int, line: str) -> Gate:
    try:
        return parse_gate(line)
    except PosetrackError as error:
        raise UsageError(str(error), where=f"{path}:{number}") from error


def _limit(number: str, text: str) -> float:
    try:
        limit = float(number)
    except ValueError as error:
        raise UsageError(
            f"condition '{text}' compares with no number", found=number, hint=_number_hint(number)
        ) from error
    if not math.isfinite(limit):
        raise UsageError(f"condition '{text}' compares with no finite number", found=number, hint=EXAMPLE)
    return limit


def _number_hint(number: str) -> str:
    if number.endswith("%"):
        return "shares are numbers from 0 to 1: write 0.99 for 99 %"
    if re.match(r"[-+.\d]", number):
        return "write the number alone: the unit is the metric's own, and the decimal sign is a point"
    return EXAMPLE


def _sign_hint(text: str) -> str:
    if re.search(r"[^<>=!]=[^=]", text):
        return "equality is =="
    signs = len(re.findall(r"[<>]", text))
    return "one condition at a time; give --fail-if again for the next" if signs > 1 else ""


def _check_part(address: Address, evaluations: Iterable[Evaluation]) -> None:
    """Feature points are named by the results: only now a misspelt one shows."""
    prefix = f"{address.metric.name}."
    measured = [one for one in evaluations if address.metric.name in one.metrics]
    bases = {base for one in measured for base in one.metrics}
    if address.metric.part == "point" and measured and address.base not in bases:
        known = {base.removeprefix(prefix) for base in bases if base.startswith(prefix)}
        hint = nearest_name(address.part or "", known) if known else "it has no parts"
        raise UsageError(f"metric '{address.metric.name}' has no '{address.part}' here", hint=hint)
