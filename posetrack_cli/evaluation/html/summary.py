"""Texts and tables of the HTML report: summary, metric tables, notes and provenance."""

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
from posetrack_cli.evaluation.reports.methods import flattened
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

# Provenance, and remarks about the page itself


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
"""Entries of the run record that are listed first."""


MOST_LISTED = 4
"""Maximum number of results whose description is not collapsed."""


@dataclass(frozen=True)
class RecordRow:
    """An entry of run records, with a value for each result; None for missing values."""

    key: str
    values: tuple[str | None, ...]

    @property
    def differs(self) -> bool:
        """Whether the results have different values."""
        return any(value != self.values[0] for value in self.values)


@dataclass(frozen=True)
class Records:
    """A table of run records or configurations."""

    title: str
    rows: tuple[RecordRow, ...]


def provenance(evaluations: Sequence[Evaluation]) -> list[Records]:
    """Return the tables of run records and configurations; empty if no result has a run record."""
    if not any(one.run for one in evaluations):
        return []
    records = [_record(one) for one in evaluations]
    configurations = [dict(_flat(_json(one.run.get("configuration", "")))) for one in evaluations]
    return [
        Records(title, _rows(columns))
        for title, columns in (("Run", records), ("Resolved configuration", configurations))
    ]


def _record(evaluation: Evaluation) -> dict[str, str]:
    """Return the flattened run record without its configuration, preceded by the file name."""
    found = {"result": evaluation.path.name}
    rank = {key: place for place, key in enumerate(FIRST)}
    for key in sorted(evaluation.run, key=lambda key: (rank.get(key, len(FIRST)), key)):
        if key != "configuration":
            found |= dict(_flat(_json(evaluation.run[key]), key))
    return found


def _json(value: str) -> Any:
    """Parse a JSON object or list; return other text unchanged."""
    if not value.lstrip().startswith(("{", "[")):
        return value
    try:
        return json.loads(value)
    except (ValueError, RecursionError):  # run records are untrusted
        return value


def _flat(value: Any, key: str = "") -> Iterator[tuple[str, str]]:
    """Yield dotted keys and texts of a nested value."""
    for name, inner in flattened(value, key):
        is_text = isinstance(inner, str)
        yield (name or "configuration", inner) if is_text else (name, json.dumps(inner, ensure_ascii=False))


def _rows(columns: Sequence[Mapping[str, str]]) -> tuple[RecordRow, ...]:
    keys = dict.fromkeys(key for column in columns for key in column)
    return tuple(RecordRow(key, tuple(column.get(key) for column in columns)) for key in keys)


def plot_remark(data: Mapping[str, Any]) -> str:
    """Return a remark if the plots over time do not show all frames; empty otherwise."""
    return _left_out(data, [(one, one["quantities"].values()) for one in data["results"]])


def component_remark(data: Mapping[str, Any]) -> str:
    """Return a remark if the trajectories do not show all frames; empty otherwise."""
    return _left_out(data, [(one, one["components"]) for one in data["results"]])


@dataclass(frozen=True)
class Held:
    """Amount of data of a result on the page."""

    name: str
    words: str


@dataclass(frozen=True)
class About:
    """Remarks on the reduction and storage of the data.

    Attributes:
        held: amount of data of each result.
        times, angles: remarks on times and angles.
    """

    held: tuple[Held, ...]
    times: str
    angles: str

    @property
    def is_short(self) -> bool:
        """Whether the descriptions of the results are not collapsed."""
        return len(self.held) <= MOST_LISTED


def about(data: Mapping[str, Any]) -> About:
    """Return remarks on the reduction and storage of the page's data."""
    return About(
        tuple(map(_held, data["results"])),
        f"Times are rounded to {data['tickSeconds'] * 1e3:.3g} ms. {_origins(data)}",
        f"Euler angles: {EULER_ORDER}; for heads, relative to facing the camera.",
    )


def _left_out(data: Mapping[str, Any], lines: Iterable[tuple[Mapping[str, Any], Iterable[Any]]]) -> str:
    """Return a remark if any line has fewer points than frames; empty otherwise."""
    reduced = [
        (result["frames"], max(one["points"] for one in of))
        for result, of in ((result, list(of)) for result, of in lines)
        if of and min(one["points"] for one in of) < result["frames"]
    ]
    if not reduced:
        return ""
    frames, points = max(reduced)
    return (
        f"To limit the size of the page, lines show up to {points} of {frames} frames, including minimum and "
        "maximum of each interval."
    )


def _held(result: Mapping[str, Any]) -> Held:
    lines = [one["points"] for one in (*result["quantities"].values(), *result["components"])]
    scene = result["scene"]
    parts = [f"{result['frames']} frames"]
    if lines:
        parts.append(f"lines of {_between(lines)} points")
    if scene is not None:
        every = "" if scene["every"] == 1 else f" (1 in {scene['every']}, and the worst frames)"
        parts.append(f"3D view of {scene['points']} frames{every}, rounded to {scene['stepMm']:.2g} mm")
    return Held(result["name"], ", ".join(parts))


def _between(counts: list[int]) -> str:
    low, high = min(counts), max(counts)
    return str(low) if low == high else f"{low} to {high}"


def _origins(data: Mapping[str, Any]) -> str:
    if len(data["results"]) < 2:
        return "Time 0 is the first frame of the result."
    if data["sharedTime"]:
        return "Time 0 is the first frame of all results."
    return "The results do not overlap in time: time 0 is the first frame of each result."


# Notices, summary and metric tables


DECISIVE = ("lost", "frames_wrong", "confidence.mean", "jitter_mm.mean", "ms_per_frame.median")
"""Metrics of the summary in addition to the key figures of the subject."""
BETTER = {"lower": " Lower is better.", "higher": " Higher is better."}


@dataclass(frozen=True)
class Described:
    """Display name and description of a metric.

    Attributes:
        address: its address.
        label, unit: display name and unit.
        meaning: description in one sentence.
    """

    address: str
    label: str
    unit: str
    meaning: str


def described(address: str) -> Described:
    """Return the description of an address, with or without a statistic."""
    base, statistic = split_address(address).base, split_address(address).statistic
    label, unit = label_and_unit(base)
    words = f"{label}, {statistic}" if statistic else label
    return Described(address, words, unit, metric_of(address).meaning)


@dataclass(frozen=True)
class Notice:
    """A note at the top of the page.

    Attributes:
        line: the text.
        names: results that it applies to; empty for all.
    """

    line: str
    names: tuple[str, ...] = ()


def notices(evaluations: Sequence[Evaluation]) -> list[Notice]:
    """Return the notes at the top of the page: remarks and lost data."""
    found: dict[str, list[str]] = {}
    for one in evaluations:
        for line in _notices_of(one):
            found.setdefault(line, []).append(one.name)
    return [Notice(line, _some(names, evaluations)) for line, names in found.items()]


def _some(names: Sequence[str], evaluations: Sequence[Evaluation]) -> tuple[str, ...]:
    """Return the names, or an empty tuple if they are all results."""
    return () if len(names) == len(evaluations) else tuple(names)


def _notices_of(evaluation: Evaluation) -> Iterator[str]:
    if evaluation.losses:
        yield f"Lost data: {loss_line(evaluation.losses)}"
    yield from evaluation.notes
    if not evaluation.coverage.frames:
        yield "The result has no estimates."
    elif not evaluation.coverage.has_truth:
        yield "No ground truth: errors are not available."


@dataclass(frozen=True)
class LeadError:
    """A main error of a result, as text."""

    label: str
    unit: str
    mean: str
    p95: str


@dataclass(frozen=True)
class LeadRange:
    """Minimum and maximum of a component over the tracked frames, as text."""

    label: str
    unit: str
    low: str
    high: str


@dataclass(frozen=True)
class Lead:
    """Text at the top of the page of a single result.

    Attributes:
        ranges: rotation and expressions of a head; empty for other subjects.
        share, due, lost: coverage, number of expected frames, number of lost frames.
        errors: main errors; angular errors first for subjects with expressions.
    """

    ranges: tuple[LeadRange, ...]
    share: str
    due: int
    lost: int
    errors: tuple[LeadError, ...]


def lead(evaluations: Sequence[Evaluation]) -> Lead | None:
    """Return the text at the top of the page of a single result; None for several results."""
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
    """Return the rows of the summary with a cell for each result, without metrics that no result has."""
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
    """A collapsed table.

    Attributes:
        summary: text of the collapsed section.
        table: the table.
        lines: lines below the table.
    """

    summary: str
    table: Table
    lines: tuple[str, ...] = ()


def folded_tables(evaluations: Sequence[Evaluation], pools: Sequence[Pool] = ()) -> list[Folded]:
    """Return the collapsed tables: all metrics, pools, parts, and reliability of the confidence."""
    if not evaluations:
        return []
    main, *more = tables(evaluations)
    found = [Folded("All metrics", main), *(Folded(table.title, table) for table in more)]
    pooled = pooled_table(pools)
    if pooled is not None:
        found.append(Folded(pooled.title, pooled, tuple(pool_lines(pools))))
    parts = _parts_only(tables(evaluations, parts=True)[0])
    if parts.sections:
        found.append(Folded("Per joint, finger, angle or point", parts))
    confidence = reliability_table(evaluations, pools)
    if confidence is not None:
        found.append(Folded("Reliability of the confidence", confidence))
    return found


def _parts_only(table: Table) -> Table:
    """Return the rows of parts, in a section per metric."""
    rows = [one for section in table.sections for one in section.rows if "." in one.address]
    names = dict.fromkeys(one.address.split(".")[0] for one in rows)
    sections = tuple(
        Section(name, tuple(one for one in rows if one.address.split(".")[0] == name)) for name in names
    )
    return Table("Parts", table.columns, sections)


def honesty_remark(evaluations: Sequence[Evaluation]) -> str:
    """Return the criteria for correct frames; empty if none was judged."""
    return " ".join(f"{line[0].upper()}{line[1:]}." for line in criterion_lines(evaluations))


@dataclass(frozen=True)
class Differences:
    """Paired differences as tables, and the lines below them."""

    tables: tuple[Table, ...]
    lines: tuple[str, ...]


def differences(comparison: Comparison | None) -> Differences | None:
    """Return the tables of a comparison, if there is one."""
    if comparison is None:
        return None
    return Differences(tuple(comparison_tables(comparison)), tuple(comparison_lines(comparison)))


@dataclass(frozen=True)
class Unmeasured:
    """Metrics without a value.

    Attributes:
        reason: why they are missing.
        addresses: their addresses.
        names: results that it applies to; empty for all.
    """

    reason: str
    addresses: tuple[str, ...]
    names: tuple[str, ...]


def unmeasured(evaluations: Sequence[Evaluation]) -> list[Unmeasured]:
    """Return the missing metrics, grouped by reason."""
    found: dict[tuple[str, tuple[str, ...]], list[str]] = {}
    for one in evaluations:
        for reason in dict.fromkeys(one.absent.values()):
            found.setdefault((reason, _addresses(one, reason)), []).append(one.name)
    return [
        Unmeasured(reason, addresses, _some(names, evaluations))
        for (reason, addresses), names in found.items()
    ]


def _addresses(evaluation: Evaluation, reason: str) -> tuple[str, ...]:
    """Return the addresses that are missing for a reason; parts only if the whole is not missing."""
    names = [name for name, why in evaluation.absent.items() if why == reason and "." not in name]
    return tuple(names or [name for name, why in evaluation.absent.items() if why == reason])


def meanings(evaluations: Sequence[Evaluation]) -> list[Described]:
    """Return the descriptions of all metrics on the page."""
    names = dict.fromkeys(base.split(".")[0] for one in evaluations for base in (*one.metrics, *one.absent))
    found = [(described(name), metric_of(name).better) for name in names]
    return [
        Described(one.address, one.label, one.unit, one.meaning + BETTER.get(better, ""))
        for one, better in found
    ]
