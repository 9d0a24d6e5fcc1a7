"""Where the results come from: run record and resolved configuration, one column for each result."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from posetrack_cli.evaluation.evaluation import Evaluation
from posetrack_cli.evaluation.html.markup import details, element, row, scrolling, text

FIRST = (
    "version",
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


def provenance(evaluations: Sequence[Evaluation]) -> str:
    """Return the tables of run records and configurations, on demand; rows that differ are marked."""
    records = [_record(one) for one in evaluations]
    configurations = [dict(_flat(_json(one.run.get("configuration", "")))) for one in evaluations]
    names = [one.name for one in evaluations]
    if not any(one.run for one in evaluations):
        return element("p", "The results state no run: who made them, from what and how.", class_="missing")
    tables = [("Run", records), ("Resolved configuration", configurations)]
    return "".join(details(title, _table(title, names, columns)) for title, columns in tables)


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


def _table(title: str, names: Sequence[str], columns: Sequence[Mapping[str, str]]) -> str:
    keys = dict.fromkeys(key for column in columns for key in column)
    if not keys:
        return element("p", "None is stated.", class_="missing")
    rows = [_row(key, [column.get(key) for column in columns]) for key in keys]
    head = [element("th", text(name), scope="col") for name in ("", *names)]
    content = element("caption", text(title)) + element("thead", row(head)) + element("tbody", "".join(rows))
    return scrolling(element("table", content, class_="record"), title)


def _row(key: str, values: Sequence[str | None]) -> str:
    differs = any(value != values[0] for value in values)
    cells = [element("td", "–" if value is None else text(value or "(empty)")) for value in values]
    mark = ' <span class="mark">differs</span>' if differs else ""
    return row([element("th", text(key) + mark, scope="row"), *cells], class_="differs" if differs else "")
