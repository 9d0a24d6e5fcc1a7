"""Gates: conditions on metrics that fail an evaluation, for continuous integration."""

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
"""Comparison operators, longest first, so that ``>=`` is not parsed as ``>``."""
GRAMMAR = "METRIC[.PART][.STATISTIC] OPERATOR NUMBER, with OPERATOR one of > >= < <= == !="
EXAMPLE = "e.g. 'joint_error_mm.mean > 10' or 'coverage < 0.99'"
PREFIX = f"{POOLED}."
"""Prefix of the address of a pooled metric."""
OVER = re.compile(rf"({'|'.join(STATISTIC_NAMES)}) *\((.*)\)")
"""Statistic over the values of all results, such as ``p95(joint_error_mm.mean)``."""
CONDITION = re.compile(rf"([^<>=!]+)({'|'.join(OPERATORS)})([^<>=!]+)")


@dataclass(frozen=True)
class Gate:
    """A condition under which an evaluation fails.

    Attributes:
        text: condition as displayed.
        address: address of the metric value.
        sign: comparison operator, a key of ``OPERATORS``.
        limit: value to compare with.
        pooled: whether it applies to the pooled value rather than to each result.
        over: statistic over the values of all results that it applies to; empty for none.
        title: name in test reports that does not change with the limit; empty for ``text``.
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
        """Full name of the metric value."""
        address = self.address
        name = address.base if address.statistic is None else f"{address.base}.{address.statistic}"
        return f"{self.over}({name})" if self.over else f"{PREFIX}{name}" if self.pooled else name


@dataclass(frozen=True)
class GateOutcome:
    """Outcome of a gate for one result or pool; the fields are keys in JSON reports.

    Attributes:
        gate: the condition.
        result: name of the result or pool.
        figure: the metric value; None if it is missing.
        failed: whether the condition holds or cannot be evaluated.
        reason: why it cannot be evaluated, else the metric value in words.
        title: title of the gate.
    """

    gate: str
    result: str
    figure: float | None
    failed: bool
    reason: str
    title: str = ""

    @property
    def line(self) -> str:
        """One line for a log."""
        if self.figure is None:
            return f"{self.result}: gate '{self.gate}' could not be evaluated: {self.reason}"
        return f"{self.result}: gate '{self.gate}' {'failed' if self.failed else 'passed'}: {self.reason}"


def gates_line(outcomes: Sequence[GateOutcome]) -> str:
    """Return the number of failed gates, such as ``1 of 3 gates failed``; empty without gates."""
    failed = sum(one.failed for one in outcomes)
    if failed:
        return f"{failed} of {len(outcomes)} gates failed"
    return f"all {len(outcomes)} gates passed" if outcomes else ""


def parse_gate(text: str) -> Gate:
    """Parse a condition ``VALUE OPERATOR NUMBER``; the gate fails if it holds.

    VALUE is ``METRIC[.PART][.STATISTIC]`` of each result, ``pooled.METRIC[.STATISTIC]`` over the frames of
    all results, or ``STATISTIC(METRIC[.PART][.STATISTIC])`` over the values of all results.

    Raises:
        UsageError: invalid syntax, or unknown metric, part or statistic.
    """
    match = CONDITION.fullmatch(text.strip())
    if match is None:
        raise UsageError(
            f"invalid condition '{text.strip()}'", expected=GRAMMAR, hint=_sign_hint(text) or EXAMPLE
        )
    name, sign, number = (part.strip() for part in match.groups())
    over, inner = _over_results(name)
    pooled = inner.startswith(PREFIX)
    if over and pooled:
        raise UsageError(f"'{inner}' is a single value, not one per result", expected=f"{over}(METRIC)")
    address = split_address(inner.removeprefix(PREFIX))
    if pooled and not is_pooled(address.base):
        _refuse_pooled(address)
    if address.statistic is None and not address.metric.scalar:
        choices = ", ".join(f"{inner}.{statistic}" for statistic in STATISTIC_NAMES)
        raise UsageError(f"condition '{text.strip()}' lacks a statistic", expected=f"one of {choices}")
    return Gate(f"{name} {sign} {number}", address, sign, _limit(number, text.strip()), pooled, over)


def _over_results(name: str) -> tuple[str, str]:
    """Split off the statistic over results, if any, from the name of the value."""
    if "(" not in name and ")" not in name:
        return "", name
    match = OVER.fullmatch(name)
    if match is None:
        known = ", ".join(f"{statistic}(...)" for statistic in STATISTIC_NAMES)
        raise UsageError(
            f"invalid statistic over results '{name}'",
            expected=f"one of {known}",
            hint="e.g. p95(joint_error_mm.mean)",
        )
    return match[1], match[2].strip()


def _refuse_pooled(address: Address) -> NoReturn:
    if address.part is not None and not address.metric.scalar:
        hint = f"use {PREFIX}{address.metric.name}, or over results p95({address.base}.mean)"
        raise UsageError(f"parts of '{address.metric.name}' are not pooled", hint=hint)
    known = ", ".join(name for name in catalogue() if is_pooled(name))
    raise UsageError(f"'{address.metric.name}' is not pooled", expected=f"one of {known}")


def read_gates(path: Path) -> list[Gate]:
    """Read a gate file: one condition per line, ``#`` starts a comment.

    Raises:
        UsageError: the file cannot be read or is empty, or a line is invalid.
    """
    try:
        # utf-8-sig: editors on Windows write a byte order mark.
        lines = read_text(path, limits.TEXT_BYTES, "utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        found = error.strerror if isinstance(error, OSError) else "bytes that are not UTF-8"
        raise UsageError("gate file cannot be read", where=path, found=found) from error
    stripped = [(number, line.partition("#")[0].strip()) for number, line in enumerate(lines, 1)]
    gates = [_gate_of_line(path, number, line) for number, line in stripped if line]
    if not gates:
        raise UsageError("gate file is empty", where=path, expected="one condition per line", hint=EXAMPLE)
    return gates


def all_gates(conditions: Iterable[str], files: Iterable[Path]) -> tuple[Gate, ...]:
    """Return the gates of all conditions, then those of all gate files.

    Raises:
        UsageError: as for ``parse_gate`` and ``read_gates``.
    """
    every = [parse_gate(text) for text in conditions]
    return (*every, *(gate for path in files for gate in read_gates(path)))


def check_gates(
    gates: Sequence[Gate], evaluations: Sequence[Evaluation], pools: Sequence[Pool] = ()
) -> list[GateOutcome]:
    """Apply each gate to all results, or to all pools if it is pooled or over results.

    A gate that cannot be evaluated fails: its value is missing or not finite, the result is empty, or the
    coverage is 0 and the metric is not in the coverage group.

    Raises:
        UsageError: a gate names a part, such as a feature point, that no result has.
    """
    # Misspelt parts are reported before any gate is evaluated, so that a typo never looks like a failed gate.
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
    """Apply a gate to a result or a pool."""
    return judge_figure(gate, evaluation.name, _judged(evaluation, gate.address))


def _check_over(gate: Gate, pool: Pool, members: Sequence[Evaluation]) -> GateOutcome:
    """Apply a gate to a statistic over the values of a pool's results; all must have a value."""
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
    """Apply a gate to a value.

    Args:
        gate: the gate.
        name: name of the result or pool.
        figure: the value, or the reason why it is missing.
        results: number of results that it is a statistic over; 0 for the value of a result or pool.
    """
    title = gate.title or gate.text
    if figure.value is None:
        return GateOutcome(gate.text, name, None, True, figure.reason, title)
    failed = OPERATORS[gate.sign](figure.value, gate.limit)
    over = f" over {results} result{'s' * (results > 1)}" if results else ""
    shown = f"{gate.figure}{over} is {shown_figure(figure.value, gate.limit)}"
    return GateOutcome(gate.text, name, figure.value, failed, shown, title)


def shown_figure(value: float, limit: float) -> str:
    """Format a value with 4 digits, or with all digits if it would then look equal to the limit."""
    # Otherwise a log could read "coverage is 0.99" for the failed gate "coverage < 0.99".
    short = f"{value:.4g}"
    return short if value == limit or float(short) != limit else repr(value)


def _judged(evaluation: Measured, address: Address) -> Figure:
    figure = figure_of(evaluation, address)
    # With coverage 0, every error is that of lost or unmatched frames: a gate must not pass on it.
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
            f"limit of condition '{text}' is not a number", found=number, hint=_number_hint(number)
        ) from error
    if not math.isfinite(limit):
        raise UsageError(f"limit of condition '{text}' is not finite", found=number, hint=EXAMPLE)
    return limit


def _number_hint(number: str) -> str:
    if number.endswith("%"):
        return "shares are numbers from 0 to 1; write 0.99 for 99 %"
    if re.match(r"[-+.\d]", number):
        return "write a plain number without unit, with a decimal point"
    return EXAMPLE


def _sign_hint(text: str) -> str:
    if re.search(r"[^<>=!]=[^=]", text):
        return "write == for equality"
    signs = len(re.findall(r"[<>]", text))
    return "write one condition per --fail-if" if signs > 1 else ""


def _check_part(address: Address, evaluations: Iterable[Evaluation]) -> None:
    """Raise an error if no result has a feature point; their names are only known from the results."""
    prefix = f"{address.metric.name}."
    measured = [one for one in evaluations if address.metric.name in one.metrics]
    bases = {base for one in measured for base in one.metrics}
    if address.metric.part == "point" and measured and address.base not in bases:
        known = {base.removeprefix(prefix) for base in bases if base.startswith(prefix)}
        hint = nearest_name(address.part or "", known) if known else "it has no parts"
        raise UsageError(f"metric '{address.metric.name}' has no '{address.part}' here", hint=hint)
