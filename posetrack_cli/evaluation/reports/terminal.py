"""Tables of text on a terminal, in a pipe or in a log."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import IO, TYPE_CHECKING, Any

from posetrack_cli.evaluation.reports.table import Table
from posetrack_cli.text import one_line

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table as RichTable

PIPE_WIDTH = 1_000_000
"""Nothing is broken or cut where no terminal says how much it shows."""
BETWEEN = 2


def print_tables(
    tables: Iterable[Table], lines: Iterable[str], file: IO[str], width: int | None = None
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
    limit = width if width is not None else None if file.isatty() else PIPE_WIDTH
    console = _console(file, limit)
    plain = console.encoding.lower() not in ("utf-8", "utf8")
    available = console.width
    for table in tables:
        for piece in _pieces(_printable(table, plain), available):
            console.width = max(available, _width(piece, range(len(piece.columns))))
            printed = _printed(console, _rendered(piece))
            file.write("".join(f"{line.rstrip()}\n" for line in (*printed.splitlines(), "")))
    for line in lines:
        file.write(_printed(console, _shown(line, plain), soft_wrap=True))


def _console(file: IO[str], width: int | None) -> Console:
    from rich.console import Console

    class OurConsole(Console):
        """Rich's would end the program where nobody reads, which is not its to decide."""

        def on_broken_pipe(self) -> None:
            raise BrokenPipeError

    return OurConsole(file=file, width=width, markup=False, emoji=False, highlight=False)


def _printed(console: Console, shown: RichTable | str, **options: Any) -> str:
    """What the console would print; it flushes the file all the same."""
    with console.capture() as capture:
        console.print(shown, **options)
    return capture.get()


def _pieces(table: Table, width: int) -> Iterator[Table]:
    """The table, or tables of some of its columns each that fit."""
    first = 0
    while first < len(table.columns):
        last = first + 1
        while last < len(table.columns) and _width(table, range(first, last + 1)) <= width:
            last += 1
        yield _columns(table, slice(first, last))
        first = last


def _columns(table: Table, wanted: slice) -> Table:
    sections = tuple(
        replace(section, rows=tuple(replace(row, cells=row.cells[wanted]) for row in section.rows))
        for section in table.sections
    )
    return replace(table, columns=table.columns[wanted], sections=sections)


def _width(table: Table, places: Sequence[int]) -> int:
    from rich.cells import cell_len

    rows = [row for section in table.sections for row in section.rows]
    labels = [cell_len(_label(row.label, row.indent)) for row in rows]
    titles = [cell_len(section.title) for section in table.sections]
    cells = [max(map(cell_len, [table.columns[at], *(row.cells[at] for row in rows)])) for at in places]
    return max([*labels, *titles, cell_len(table.title)]) + sum(BETWEEN + cell for cell in cells)


def _rendered(table: Table) -> RichTable:
    from rich.table import Table as RichTable
    from rich.text import Text

    made = RichTable(box=None, padding=(0, BETWEEN, 0, 0), pad_edge=False, header_style="bold")
    made.add_column(Text(table.title), no_wrap=True)
    for column in table.columns:
        made.add_column(Text(column), justify="right", no_wrap=True)
    for section in table.sections:
        if section.title:
            made.add_row(Text(section.title, style="bold cyan"))
        for row in section.rows:
            made.add_row(*map(Text, (_label(row.label, row.indent), *row.cells)))
    return made


def _printable(table: Table, plain: bool) -> Table:
    """The table as ``_shown`` makes its texts: names of results, joints and persons come from files."""

    def shown(text: str) -> str:
        return _shown(text, plain)

    sections = tuple(
        replace(
            section,
            title=shown(section.title),
            rows=tuple(
                replace(row, label=shown(row.label), cells=tuple(map(shown, row.cells)))
                for row in section.rows
            ),
        )
        for section in table.sections
    )
    return replace(
        table, title=shown(table.title), columns=tuple(map(shown, table.columns)), sections=sections
    )


def _label(label: str, indent: int) -> str:
    return "  " * indent + label


def _shown(text: str, plain: bool) -> str:
    """Return text on one line without control characters; +- where an output has no sign for it."""
    safe = one_line(text)
    return safe.replace("\u00b1", "+-") if plain else safe
