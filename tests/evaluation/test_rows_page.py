"""The page of many results: complete without script, safe, and of thousands of rows still a page."""

from __future__ import annotations

import html
import re
from html.parser import HTMLParser
from pathlib import Path

import pytest

from posetrack_cli.errors import UsageError
from posetrack_cli.evaluation.html import packing, rows_page
from posetrack_cli.evaluation.html.rows_page import RowsPage, Thumbnail, write_rows_html
from posetrack_cli.evaluation.judging.gates import GateOutcome, check_gates, parse_gate
from posetrack_cli.evaluation.measuring.evaluation import Evaluation
from support.html import NASTY
from support.rows import Before, many_results, result, result_set

MANY = 2000
LARGEST_ROW = 3000
"""Bytes: a dozen figures with their changes."""


class Reader(HTMLParser):
    """Tables as rows of cells of text, all tags, and the attributes of cells."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tables: list[list[list[str]]] = []
        self.tags: set[str] = set()
        self._cell = False
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        if tag == "table":
            self.tables.append([])
        elif tag == "tr":
            self.tables[-1].append([])
        elif tag in ("td", "th"):
            self.tables[-1][-1].append("")
            self._cell = True

    def handle_endtag(self, tag: str) -> None:
        self._cell = self._cell and tag not in ("td", "th")

    def handle_data(self, data: str) -> None:
        if self._cell:
            self.tables[-1][-1][-1] += data


def page(members: list[Evaluation], earlier: dict[str, Before] | None = None, *conditions: str) -> str:
    outcomes = check_gates([parse_gate(text) for text in conditions], members)
    return rows_page.rows_page(RowsPage([result_set(members, outcomes, earlier)], outcomes))


def test_totals_stand_above_a_row_for_each_result() -> None:
    members = [result("a", 2.0), result("b", 8.0)]
    earlier = {"a": Before(1.5), "b": Before(9.0), "pooled": Before(4.0)}
    totals, rows = Reader(page(members, earlier, "joint_error_mm.mean > 5")).tables
    assert ["joint error, mean mm", "5", "4", "+1"] in totals
    head, first, second, last = rows
    place = head.index("joint error, mean mm")
    assert [row[0] for row in (first, second, last)] == ["b", "a", "Total of 2"]
    assert first[place : place + 2] == ["8", "\u22121"] and second[place : place + 2] == ["2", "+0.5000"]
    assert [row[-1] for row in (first, second)] == ["1", "0"]
    assert {len(row) for row in rows} == {len(head)}


def test_only_what_is_worse_stands_out() -> None:
    worse = re.findall(r'<td[^>]*class="worse"[^>]*>([^<]*)', page([result("a", 2.0)], {"a": Before(1.5)}))
    assert worse == ["\u22120.5000", "+0.5000", "+1.425"]  # coverage 1, mean 2, 95th percentile 2.925
    better = page([result("a", 2.0)], {"a": Before(1.0)})  # the coverage is as it was, errors are larger
    assert "\u2212" not in "".join(re.findall(r'class="worse"[^>]*>([^<]*)', better))


def test_failed_gates_are_listed_first() -> None:
    text = page([result("a", 2.0), result("b", 8.0)], None, "joint_error_mm.mean > 5")
    assert text.index("b: gate &#39;joint_error_mm.mean &gt; 5&#39; failed") < text.index("<table")
    assert "1 of 2 gates failed." in text


def test_hostile_names_are_text() -> None:
    bad = GateOutcome(NASTY, NASTY, 1.0, True, NASTY)
    text = rows_page.rows_page(RowsPage([result_set([result(NASTY, 2.0)], [bad])], [bad], [NASTY]))
    reader = Reader(text)
    assert "img" not in reader.tags and text.count("</script>") == 1
    assert reader.tables[-1][1][0] == NASTY.replace("\u202e", "\ufffd")


def test_the_policy_allows_the_pages_own_script_alone() -> None:
    text = html.unescape(page([result("a", 2.0)]))
    assert "default-src 'none'" in text and "<script src" not in text and "unsafe" not in text
    script = text[text.index("<script>") + len("<script>") : text.index("</script>")]
    assert packing.policy("", script).split("; ")[1] in text


def test_two_thousand_rows_are_one_page(tmp_path: Path) -> None:
    members = many_results(MANY)
    found = result_set(members, check_gates([parse_gate("joint_error_mm.mean > 90")], members))
    path = tmp_path / "page.html"
    write_rows_html(path, RowsPage([found]))
    assert path.stat().st_size < MANY * LARGEST_ROW
    rows = Reader(path.read_text()).tables[-1]
    assert len(rows) == MANY + 2 and rows[-1][0] == f"Total of {MANY}"
    place = rows[0].index("joint error, mean mm")
    errors = [float(row[place]) for row in rows[1:-1]]
    assert errors == sorted(errors, reverse=True) and len({row[0] for row in rows}) == MANY + 2


def test_a_page_is_named_as_one(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="expected a name that ends with"):
        write_rows_html(tmp_path / "page.txt", RowsPage([result_set([result("a", 2.0)])]))


def test_distributions_are_histograms_over_results_with_different_values() -> None:
    """Errors of 1 to 10 mm fill 20 bins in pairs of one and none; coverage is 1 everywhere."""
    text = page(many_results(10))
    (shape,) = re.findall(r'<svg[^>]*aria-label="joint_error_mm.mean: ([^"]*)">(.*?)</svg>', text)
    assert shape[0] == "1 to 10, median 5.500"
    heights = {float(height) for height in re.findall(r' height="([0-9.]+)"', shape[1])}
    assert heights == {60.0} and shape[1].count("<rect") == 10
    assert "<svg" not in page(many_results(4))


def test_thumbnails_link_to_their_pages() -> None:
    worst = (Thumbnail(NASTY, "./a%20b.html", "data:image/png;base64,AAAA", "frame 3, lost"),)
    text = rows_page.rows_page(RowsPage([result_set(many_results(2))], worst=worst))
    assert '<a href="./a%20b.html"><img src="data:image/png;base64,AAAA"' in text and "frame 3, lost" in text
    assert NASTY[:40] not in text and NASTY[:40] in html.unescape(text)
