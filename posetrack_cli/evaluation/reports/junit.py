"""Outcomes of gates as JUnit XML, which GitLab, Jenkins and reporters of GitHub show as tests."""

from __future__ import annotations

import re
from collections.abc import Sequence
from xml.etree import ElementTree as ET

from posetrack_cli.evaluation.gates import GateOutcome

SUITE = "posetrack eval"
# All that XML 1.0 allows but C1 controls; not lone surrogates, which stand for bytes that are no UTF-8.
_FORBIDDEN = re.compile("[^\t\n\x20-\x7e\xa0-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def junit_report(outcomes: Sequence[GateOutcome], suite: str = SUITE) -> str:
    """Return a document with one test for each outcome; one that failed has a failure with its message.

    The class of a test is the result's name, its own name the gate's title, which stays from run to run. The
    type of a failure is ``failed`` or, where there was no figure, ``not judged``. No time is in it: equal
    outcomes give equal text.

    Args:
        outcomes: of gates and baselines.
        suite: what the suite is called.
    """
    counts = {"tests": str(len(outcomes)), "failures": str(sum(one.failed for one in outcomes))}
    counts |= {"errors": "0"}
    top = ET.Element("testsuites", {"name": _allowed(suite), **counts})
    tests = ET.SubElement(top, "testsuite", {"name": _allowed(suite), **counts, "skipped": "0"})
    for one in outcomes:
        names = {"classname": _allowed(one.result), "name": _allowed(one.title or one.gate)}
        test = ET.SubElement(tests, "testcase", names)
        if one.failed:
            kind = "not judged" if one.figure is None else "failed"
            failure = ET.SubElement(test, "failure", {"message": _allowed(one.reason), "type": kind})
            failure.text = _allowed(one.line)
    ET.indent(top, " ")
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(top, encoding="unicode") + "\n"


def _allowed(text: str) -> str:
    """Return text without the characters that no XML may hold, and without other controls."""
    return _FORBIDDEN.sub("", text)
