"""Tables of text on a terminal, in a pipe or in a log."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Sequence
from shutil import get_terminal_size
from typing import TextIO
from unicodedata import combining, east_asian_width

from posetrack_cli.evaluation.reports.table import Table
from posetrack_cli.text import one_line

PIPE_WIDTH = 1_000_000
"""Nothing is broken or cut where no terminal says how much it shows."""
BETWEEN = 2
"""Columns of text between two of a table."""

_BOLD = "\x1b[1m"
_BOLD_CYAN = "\x1b[1;36m"
_RESET = "\x1b[0m"


def print_tables(
    tables: Iterable[Table], lines: Iterable[str], file: TextIO, width: int | None = None
) -> None:
    """Print tables and the lines below them; colours only on a terminal.

    Columns that do not fit beside each other on a terminal go below each other; nothing is left out or cut,
    and one column that alone is too wide is left to the terminal to break.

    Args:
        tables: what to show.
        lines: closing lines; the terminal breaks long ones.
        file: where to.
        width: columns of text; by default the terminal's, or no limit.
    """
    is_terminal = file.isatty()
    available = width or (get_terminal_size().columns if is_terminal else PIPE_WIDTH)
    coloured = is_terminal and not os.environ.get("NO_COLOR") and os.environ.get("TERM") != "dumb"
    plain = (file.encoding or "utf-8").lower() not in ("utf-8", "utf8")
    for table in tables:
        rows = list(_rows(table, plain))
        widths = [max(map(_width, column)) for column in zip(*(texts for _, texts in rows), strict=True)]
        for piece in _pieces(widths, available):
            for style, texts in rows:
                line = _line([texts[at] for at in piece], [widths[at] for at in piece])
                file.write(f"{style}{line}{_RESET}\n" if coloured and style else f"{line}\n")
            file.write("\n")
    for line in lines:
        file.write(f"{_shown(line, plain)}\n")


def _rows(table: Table, plain: bool) -> Iterator[tuple[str, list[str]]]:
    """Yield the style and the texts of each row, the header first: all have the same number of texts."""
    rows = [(_BOLD, [table.title, *table.columns])]
    for section in table.sections:
        if section.title:
            rows.append((_BOLD_CYAN, [section.title, *[""] * len(table.columns)]))
        rows += [("", ["  " * row.indent + row.label, *row.cells]) for row in section.rows]
    for style, texts in rows:
        yield style, [_shown(text, plain) for text in texts]


def _pieces(widths: Sequence[int], limit: int) -> Iterator[list[int]]:
    """Yield which columns stand beside each other: that of the labels, and as many others as fit."""
    piece = [0]
    for at in range(1, len(widths)):
        if len(piece) > 1 and sum(widths[one] + BETWEEN for one in [*piece, at]) - BETWEEN > limit:
            yield piece
            piece = [0]
        piece.append(at)
    if len(piece) > 1:
        yield piece


def _line(texts: Sequence[str], widths: Sequence[int]) -> str:
    """Return the label, flush left, and the other texts, flush right."""
    gaps = [" " * (width - _width(text)) for text, width in zip(texts, widths, strict=True)]
    others = [" " * BETWEEN + gap + text for text, gap in zip(texts[1:], gaps[1:], strict=True)]
    return "".join([texts[0], gaps[0], *others]).rstrip()


def _width(text: str) -> int:
    """Return how many columns of a terminal a text takes."""
    return sum(0 if combining(char) else 2 if east_asian_width(char) in "WF" else 1 for char in text)


def _shown(text: str, plain: bool) -> str:
    """Return text on one line without control characters; +- where an output has no sign for it.

    Names of results, joints and persons come from files.
    """
    safe = one_line(text).expandtabs()
    return safe.replace("\u00b1", "+-") if plain else safe
