"""Tables: what readers refuse of strangers; names in those that are written are text to spreadsheets."""

from __future__ import annotations

import csv
import io
from fractions import Fraction
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from posetrack_cli import limits
from posetrack_cli.errors import RecordingError
from posetrack_cli.tables import NS_PER_UNIT, Table, TextFile, csv_of, number_of, whole_of


def table_of(tmp_path: Path, text: str) -> Table:
    path = tmp_path / "t.csv"
    path.write_text(text)
    return TextFile(path, RecordingError, "stamps are a CSV file", most=100).table(("t_s", "x"))


def test_rows_are_cells_with_their_lines(tmp_path: Path) -> None:
    table = table_of(tmp_path, '\ufeff# c\n\n t_s , "x"\n# d\n 1, "a, b"\n,\n"2\n3",x')
    assert (table.names, table.header) == (("t_s", "x"), f"{tmp_path / 't.csv'} line 3")
    assert list(table) == [(5, ["1", "a, b"]), (8, ["2\n3", "x"])]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "is empty, expected t_s, x"),
        ("1,2\n1,2\n", "unknown header, found 1, 2, expected t_s, x"),
        ("t_s,y\n", "unknown header, found t_s, y, expected t_s, x"),
        ("t_s;x\n1;2\n", "columns are not separated by commas, found semicolons"),
        ("t_s,x,x\n", "column occurs twice, found x"),
        ("t_s,x\n1\n", "line 2: row does not fit the header, found 1 cells, expected 2"),
        ("t_s,x\n" * 20, "is too large, found 120 bytes, expected 100 at most"),
        ("t_s,x\r1,2\r", "line 1: is not valid CSV, found a bare carriage return"),
    ],
)
def test_tables_that_cannot_be_meant(tmp_path: Path, text: str, says: str) -> None:
    with pytest.raises(RecordingError, match=says):
        list(table_of(tmp_path, text))


@given(st.decimals(0, 9 * 10**9, places=9), st.sampled_from(list(NS_PER_UNIT.values())))
def test_stamps_are_those_of_fractions(value: object, ns: int) -> None:
    exact = Fraction(str(value)) * ns
    if ns == 1 and exact.denominator > 1:
        with pytest.raises(RecordingError, match="stamp is not a whole number"):
            whole_of(str(value), "", RecordingError, ns)
    assert whole_of(str(value), "", RecordingError, ns, fractions=True) == round(exact)


@pytest.mark.parametrize("value", ["-1", "1e9999", str(2**63), "inf", "nan", "x", "", "1.5", True, [1]])
def test_no_other_value_is_a_number_of_a_frame(value: object) -> None:
    with pytest.raises(RecordingError, match="frame number is"):
        whole_of(value, "", RecordingError)


@pytest.mark.parametrize("value", ["x", "inf", "-inf", "1e13", True, [1.0], {}, 10**400])
def test_values_that_are_no_numbers(value: object) -> None:
    for optional in (False, True):
        with pytest.raises(RecordingError, match=r"is (not a number|not finite|too large), found .{1,50}"):
            number_of(value, "", RecordingError, optional=optional)


@pytest.mark.parametrize("nothing", ["", " NaN ", "none", None, float("nan")])
def test_nothing_is_a_number_only_where_it_may_be(nothing: object) -> None:
    assert number_of(nothing, "", RecordingError, optional=True) != number_of(0, "", RecordingError)
    with pytest.raises(RecordingError):
        number_of(nothing, "", RecordingError)


def test_a_line_without_end_is_refused(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_bytes(b"a" * (limits.LINE_BYTES + 1))
    with pytest.raises(RecordingError, match="line 1: line is too long"):
        next(TextFile(tmp_path / "t.csv", RecordingError, "").lines())


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
