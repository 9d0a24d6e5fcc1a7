"""JUnit XML, read back as reporters read it."""

from __future__ import annotations

from xml.etree import ElementTree as ET

from hypothesis import given
from hypothesis import strategies as st

from posetrack_cli.evaluation.judging.gates import GateOutcome
from posetrack_cli.evaluation.reports.writing import junit_report
from support.html import NASTY

PASSED = GateOutcome("coverage < 0.9", "a", 1.0, False, "coverage is 1", "coverage < 0.9")
FAILED = GateOutcome("lost > 1 (baseline 0)", "b", 5.0, True, "lost is 5", "baseline: lost")
UNJUDGED = GateOutcome("nees.mean > 1", "b", None, True, "no truth")


def test_each_outcome_is_a_test_and_failures_are_counted() -> None:
    top = ET.fromstring(junit_report([PASSED, FAILED, UNJUDGED]).encode())
    (suite,) = top
    for one in (top, suite):
        assert (one.get("tests"), one.get("failures"), one.get("errors")) == ("3", "2", "0")
    tests = suite.findall("testcase")
    assert [(one.get("classname"), one.get("name"), len(one)) for one in tests] == [
        ("a", "coverage < 0.9", 0),
        ("b", "baseline: lost", 1),
        ("b", "nees.mean > 1", 1),
    ]
    failures = suite.findall("testcase/failure")
    assert [(one.get("type"), one.get("message")) for one in failures] == [
        ("failed", "lost is 5"),
        ("not judged", "no truth"),
    ]
    assert failures[0].text == FAILED.line


def test_no_outcome_is_an_empty_suite() -> None:
    top = ET.fromstring(junit_report([]))
    assert top.get("tests") == "0" and top.findall(".//testcase") == []


@given(st.one_of(st.text(st.characters()), st.text(st.characters(categories=["Cc", "Cs", "Cn"]))))
def test_whatever_a_name_holds_the_document_can_be_read(name: str) -> None:
    outcome = GateOutcome(f"{name} > 1", name, None, True, name, name)
    written = junit_report([outcome], name).encode()  # no surrogate is left
    test = ET.fromstring(written).find(".//testcase")
    assert test is not None
    kept = "".join(c for c in name if c.isprintable())
    assert "".join(c for c in test.get("classname") or "" if c.isprintable()) == kept


def test_what_looks_like_a_tag_is_text() -> None:
    outcome = GateOutcome("]]><x/>", f"\x1b[31m{NASTY}\x00", None, True, "]]>", "")
    top = ET.fromstring(junit_report([outcome]).encode())
    assert {one.tag for one in top.iter()} == {"testsuites", "testsuite", "testcase", "failure"}
    (test,) = top.findall(".//testcase")
    assert test.get("classname") == f"[31m{NASTY}"
