"""CSV that is written: a stranger's names are text to a spreadsheet, and numbers stay numbers."""

from __future__ import annotations

import csv
import io

import pytest

from posetrack_cli.tables import csv_of


def cells(*written: object) -> list[str]:
    (row,) = csv.reader(io.StringIO(csv_of([written]), newline=""))
    return row


@pytest.mark.parametrize(
    "name", ["=1+1", "+cmd|' /C calc'!A0", "-2+3", "@SUM(A1)", "\uff1d1", "--1", "-1e", "+"]
)
def test_what_a_spreadsheet_would_run_is_text(name: str) -> None:
    assert cells("a", name) == ["a", f"'{name}"]


@pytest.mark.parametrize("name", ["\t=1", "\r=1", "\n=1", "\x1b[31m=1", "\udcff", "a\tb"])
def test_controls_are_escapes(name: str) -> None:
    (cell,) = cells(name)
    assert cell.isprintable() and cell[0] not in "=+-@" and cell.isascii()


@pytest.mark.parametrize(
    "number", [-0.5, -3, 1e-300, float("-inf"), float("nan"), "-0.5", "-1.5e-07", "-inf", "+2", "5."]
)
def test_numbers_stay_numbers(number: float | str) -> None:
    (cell,) = cells(number)
    assert cell == str(number)
    assert repr(float(cell)) == repr(float(number))


def test_other_text_is_as_it_was() -> None:
    assert csv_of([["day 1/a-b", 'say "x", y', "手", ""], [None, 1]]) == 'day 1/a-b,"say ""x"", y",手,\n,1\n'
