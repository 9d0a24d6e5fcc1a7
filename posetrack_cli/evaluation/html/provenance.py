"""Where the results come from, and what the page says about itself."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from posetrack_cli.evaluation.evaluation import Evaluation
from posetrack_cli.geometry.euler import EULER_ORDER

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
