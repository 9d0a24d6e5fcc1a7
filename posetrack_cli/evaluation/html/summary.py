"""What the report says in words: figures, and where a result comes from."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from posetrack_cli.evaluation.html.components import leading_components
from posetrack_cli.evaluation.judging.comparing import Comparison
from posetrack_cli.evaluation.measuring.catalogue import (
    figure_of,
    key_figures,
    label_and_unit,
    metric_of,
    split_address,
)
from posetrack_cli.evaluation.measuring.evaluation import Evaluation, Statistics
from posetrack_cli.evaluation.measuring.pooling import Pool
from posetrack_cli.evaluation.measuring.subjects import KINDS
from posetrack_cli.evaluation.reports.table import (
    ABSENT,
    Row,
    Section,
    Table,
    comparison_lines,
    comparison_tables,
    criterion_lines,
    pool_lines,
    pooled_table,
    reliability_table,
    shown,
    tables,
)
from posetrack_cli.geometry.rotations import EULER_ORDER
from posetrack_cli.losses import loss_line

# Where the results come from, and what the page says about itself


FIRST = (
    "version",
    "sources",
    "tracker",
    "input.name",
    "input.sha256",
    "input.kind",
    "input.frames",
    "input.bytes",
    "seed",
    "renderer",
)
"""Entries that are told first, in this order."""


MOST_LISTED = 4
"""How many results are described without being asked for."""


@dataclass(frozen=True)
class RecordRow:
    """An entry of run records: a value for each result, None where it has none."""

    key: str
    values: tuple[str | None, ...]

    @property
    def differs(self) -> bool:
        """Whether results have different values."""
        return any(value != self.values[0] for value in self.values)


@dataclass(frozen=True)
class Records:
    """A table of run records or configurations."""

    title: str
    rows: tuple[RecordRow, ...]


def provenance(evaluations: Sequence[Evaluation]) -> list[Records]:
    """Return the tables of run records and configurations; none if no result states a run."""
    if not any(one.run for one in evaluations):
        return []
    records = [_record(one) for one in evaluations]
    configurations = [dict(_flat(_json(one.run.get("configuration", "")))) for one in evaluations]
    return [
        Records(title, _rows(columns))
        for title, columns in (("Run", records), ("Resolved configuration", configurations))
    ]


def _record(evaluation: Evaluation) -> dict[str, str]:
    """The run record without its configuration, structured values flattened, the result's file first."""
    found = {"result": evaluation.path.name}
    rank = {key: place for place, key in enumerate(FIRST)}
    for key in sorted(evaluation.run, key=lambda key: (rank.get(key, len(FIRST)), key)):
        if key != "configuration":
            found |= dict(_flat(_json(evaluation.run[key]), key))
    return found


def _json(value: str) -> Any:
    """What a JSON object or list holds; other text as it is."""
    if not value.lstrip().startswith(("{", "[")):
        return value
    try:
        return json.loads(value)
    except (ValueError, RecursionError):
        return value


def _flat(value: Any, key: str = "") -> Iterator[tuple[str, str]]:
    """Yield dotted keys and texts of a nested value."""
    if isinstance(value, Mapping):
        for name, inner in value.items():
            yield from _flat(inner, f"{key}.{name}" if key else str(name))
    elif isinstance(value, str):
        yield key or "configuration", value
    else:
        yield key, json.dumps(value, ensure_ascii=False)


def _rows(columns: Sequence[Mapping[str, str]]) -> tuple[RecordRow, ...]:
    keys = dict.fromkeys(key for column in columns for key in column)
    return tuple(RecordRow(key, tuple(column.get(key) for column in columns)) for key in keys)


def plot_remark(data: Mapping[str, Any]) -> str:
    """Say how many frames the lines over time hold, where they do not hold all."""
    return _left_out(data, [(one, one["quantities"].values()) for one in data["results"]])


def component_remark(data: Mapping[str, Any]) -> str:
    """The same of the trajectories."""
    return _left_out(data, [(one, one["components"]) for one in data["results"]])


@dataclass(frozen=True)
class Held:
    """How much the page holds of a result."""

    name: str
    words: str


@dataclass(frozen=True)
class About:
    """How the page's data are reduced and stored.

    Attributes:
        held: of each result.
        times, angles: one sentence or two.
    """

    held: tuple[Held, ...]
    times: str
    angles: str

    @property
    def is_short(self) -> bool:
        """Whether all results are described without being asked for."""
        return len(self.held) <= MOST_LISTED


def about(data: Mapping[str, Any]) -> About:
    """Return how the page's data are reduced and stored."""
    return About(
        tuple(map(_held, data["results"])),
        f"Times are stored in steps of {data['tickSeconds'] * 1e3:.3g} ms. {_origins(data)}",
        f"Euler angles: {EULER_ORDER}; of a head, the turn away from looking at the camera.",
    )


def _left_out(data: Mapping[str, Any], lines: Iterable[tuple[Mapping[str, Any], Iterable[Any]]]) -> str:
    """One sentence if any line of any result holds fewer points than there are frames."""
    reduced = [
        (result["frames"], max(one["points"] for one in of))
        for result, of in ((result, list(of)) for result, of in lines)
        if of and min(one["points"] for one in of) < result["frames"]
    ]
    if not reduced:
        return ""
    frames, points = max(reduced)
    return (
        f"To keep the page small a line shows at most {points} of {frames} frames: in every interval those "
        "with the smallest and the largest value, so that no peak is lost."
    )


def _held(result: Mapping[str, Any]) -> Held:
    lines = [one["points"] for one in (*result["quantities"].values(), *result["components"])]
    scene = result["scene"]
    parts = [f"{result['frames']} frames"]
    if lines:
        parts.append(f"lines of {_between(lines)} points")
    if scene is not None:
        every = "" if scene["every"] == 1 else f", one in {scene['every']} and the worst ones"
        parts.append(f"3-D view of {scene['points']} frames{every}, in steps of {scene['stepMm']:.2g} mm")
    return Held(result["name"], ", ".join(parts))


def _between(counts: list[int]) -> str:
    low, high = min(counts), max(counts)
    return str(low) if low == high else f"{low} to {high}"


def _origins(data: Mapping[str, Any]) -> str:
    if len(data["results"]) < 2:
        return "Time 0 is the result's first frame."
    if data["sharedTime"]:
        return "Time 0 is the first frame of all results."
    return "The results share no time: time 0 is each one's own first frame."


# What the page says before and below its plots: what to know first, the figures that decide, all figures


DECISIVE = ("lost", "frames_wrong", "confidence.mean", "jitter_mm.mean", "ms_per_frame.median")
"""What tells how good a track is beside the key figures of its subject."""
BETTER = {"lower": " Lower is better.", "higher": " Higher is better."}


@dataclass(frozen=True)
class Described:
    """A figure in words.

    Attributes:
        address: its name.
        label, unit: what it is called.
        meaning: one sentence.
    """

    address: str
    label: str
    unit: str
    meaning: str


def described(address: str) -> Described:
    """Return what a figure is called, given its address with or without a statistic."""
    base, statistic = split_address(address).base, split_address(address).statistic
    label, unit = label_and_unit(base)
    words = f"{label}, {statistic}" if statistic else label
    return Described(address, words, unit, metric_of(address).meaning)


@dataclass(frozen=True)
class Notice:
    """A line that must be known before any figure.

    Attributes:
        line: what it says.
        names: of the results that it holds for; none if it holds for all.
    """

    line: str
    names: tuple[str, ...] = ()


def notices(evaluations: Sequence[Evaluation]) -> list[Notice]:
    """Return what a reader must know first: notes, and data that could not be read."""
    found: dict[str, list[str]] = {}
    for one in evaluations:
        for line in _notices_of(one):
            found.setdefault(line, []).append(one.name)
    return [Notice(line, _some(names, evaluations)) for line, names in found.items()]


def _some(names: Sequence[str], evaluations: Sequence[Evaluation]) -> tuple[str, ...]:
    """The names, or none if they are all."""
    return () if len(names) == len(evaluations) else tuple(names)


def _notices_of(evaluation: Evaluation) -> Iterator[str]:
    if evaluation.losses:
        yield f"Data lost: {loss_line(evaluation.losses)}"
    yield from evaluation.notes
    if not evaluation.coverage.frames:
        yield "The result holds no estimate."
    elif not evaluation.coverage.has_truth:
        yield "No truth: errors cannot be told, only what the run says of itself."


@dataclass(frozen=True)
class LeadError:
    """The main error of a result, as text."""

    label: str
    unit: str
    mean: str
    p95: str


@dataclass(frozen=True)
class LeadRange:
    """The least and largest value of a component while it was tracked, as text."""

    label: str
    unit: str
    low: str
    high: str


@dataclass(frozen=True)
class Lead:
    """What a page of one result begins with, as text.

    Attributes:
        ranges: how a head is turned and what its face does; empty of other subjects.
        share, due, lost: coverage.
        errors: the main ones; angles come first where the page begins with them.
    """

    ranges: tuple[LeadRange, ...]
    share: str
    due: int
    lost: int
    errors: tuple[LeadError, ...]


def lead(evaluations: Sequence[Evaluation]) -> Lead | None:
    """Return what the only result is like; None of several."""
    if len(evaluations) != 1:
        return None
    (evaluation,) = evaluations
    coverage = evaluation.coverage
    errors = []
    kind = KINDS[evaluation.subject]
    for name in sorted(kind.lead, key=lambda name: bool(kind.expressions) and not name.endswith("_deg")):
        value = evaluation.metrics.get(name)
        if isinstance(value, Statistics) and value.count:
            errors.append(LeadError(*label_and_unit(name), shown(value.mean), shown(value.p95)))
    due, ranges = coverage.frames + coverage.missed, tuple(_ranges(evaluation))
    return Lead(ranges, shown(coverage.share), due, coverage.lost, tuple(errors))


def _ranges(evaluation: Evaluation) -> Iterator[LeadRange]:
    """Yield the ranges of the leading components over the frames that are not lost."""
    lost = evaluation.track.lost
    for one in leading_components(evaluation):
        values = one.estimate if lost is None else one.estimate[~lost]
        values = values[np.isfinite(values)]
        if values.size:
            low, high = (f"{value:z.{1 if one.unit else 2}f}" for value in (values.min(), values.max()))
            yield LeadRange(one.label, one.unit, low, high)


def decisive_rows(evaluations: Sequence[Evaluation]) -> list[Row]:
    """Return the few figures that decide, those that any result has, with a cell for each result."""
    addresses = dict.fromkeys(
        address for one in evaluations for address in (*key_figures(one.subject), *DECISIVE)
    )
    rows = [Row(address, _cells(evaluations, address), address) for address in addresses]
    return [row for row in rows if any(cell != ABSENT for cell in row.cells)]


def _cells(evaluations: Iterable[Evaluation], address: str) -> tuple[str, ...]:
    values = [figure_of(one, address).value for one in evaluations]
    return tuple(ABSENT if value is None else shown(value) for value in values)


@dataclass(frozen=True)
class Folded:
    """A table that is shown on demand.

    Attributes:
        summary: what it is behind.
        table: what it shows.
        lines: what belongs under it.
    """

    summary: str
    table: Table
    lines: tuple[str, ...] = ()


def folded_tables(evaluations: Sequence[Evaluation], pools: Sequence[Pool] = ()) -> list[Folded]:
    """Return the tables of all figures, those of results together, of parts and of confidence."""
    if not evaluations:
        return []
    main, *more = tables(evaluations)
    found = [Folded("Every figure", main), *(Folded(table.title, table) for table in more)]
    pooled = pooled_table(pools)
    if pooled is not None:
        found.append(Folded(pooled.title, pooled, tuple(pool_lines(pools))))
    parts = _parts_only(tables(evaluations, parts=True)[0])
    if parts.sections:
        found.append(Folded("Per joint, finger, angle or point", parts))
    confidence = reliability_table(evaluations, pools)
    if confidence is not None:
        found.append(Folded("Reliability of confidence", confidence))
    return found


def _parts_only(table: Table) -> Table:
    """Rows about parts, under the metric they belong to."""
    rows = [one for section in table.sections for one in section.rows if "." in one.address]
    names = dict.fromkeys(one.address.split(".")[0] for one in rows)
    sections = tuple(
        Section(name, tuple(one for one in rows if one.address.split(".")[0] == name)) for name in names
    )
    return Table("Parts", table.columns, sections)


def honesty_remark(evaluations: Sequence[Evaluation]) -> str:
    """Say what makes a frame right; nothing where none was judged."""
    return " ".join(f"{line[0].upper()}{line[1:]}." for line in criterion_lines(evaluations))


@dataclass(frozen=True)
class Differences:
    """Paired differences as tables, and what belongs under them."""

    tables: tuple[Table, ...]
    lines: tuple[str, ...]


def differences(comparison: Comparison | None) -> Differences | None:
    """Return what a comparison shows, if there is one."""
    if comparison is None:
        return None
    return Differences(tuple(comparison_tables(comparison)), tuple(comparison_lines(comparison)))


@dataclass(frozen=True)
class Unmeasured:
    """Figures without a value.

    Attributes:
        reason: why.
        addresses: which.
        names: of the results that it holds for; none if it holds for all.
    """

    reason: str
    addresses: tuple[str, ...]
    names: tuple[str, ...]


def unmeasured(evaluations: Sequence[Evaluation]) -> list[Unmeasured]:
    """Return what has no value, and why: one entry for each reason and what it is about."""
    found: dict[tuple[str, tuple[str, ...]], list[str]] = {}
    for one in evaluations:
        for reason in dict.fromkeys(one.absent.values()):
            found.setdefault((reason, _addresses(one, reason)), []).append(one.name)
    return [
        Unmeasured(reason, addresses, _some(names, evaluations))
        for (reason, addresses), names in found.items()
    ]


def _addresses(evaluation: Evaluation, reason: str) -> tuple[str, ...]:
    """What lacks a value for a reason; its parts only where it has one itself."""
    names = [name for name, why in evaluation.absent.items() if why == reason and "." not in name]
    return tuple(names or [name for name, why in evaluation.absent.items() if why == reason])


def meanings(evaluations: Sequence[Evaluation]) -> list[Described]:
    """Return every figure on the page in words."""
    names = dict.fromkeys(base.split(".")[0] for one in evaluations for base in (*one.metrics, *one.absent))
    found = [(described(name), metric_of(name).better) for name in names]
    return [
        Described(one.address, one.label, one.unit, one.meaning + BETTER.get(better, ""))
        for one, better in found
    ]
