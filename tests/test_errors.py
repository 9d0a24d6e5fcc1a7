"""Errors are one line: what, where, found, expected, what to do; and each kind has its exit code."""

from __future__ import annotations

import pytest

from posetrack_cli.errors import (
    PosetrackError,
    RecordingError,
    RenderingError,
    ResultError,
    UsageError,
    nearest_name,
)


def test_all_parts_in_their_order_on_one_line() -> None:
    error = PosetrackError("no depth\n in it", where="a.mcap", found=3, expected="4", hint="try\n\tagain")
    assert str(error) == "a.mcap: no depth in it, found 3, expected 4; try again"


def test_only_what_is_given() -> None:
    assert str(PosetrackError("broken")) == "broken"
    assert str(PosetrackError("broken", found=0)) == "broken, found 0"
    assert str(PosetrackError("broken", where="x", hint="mend it")) == "x: broken; mend it"


@pytest.mark.parametrize(
    ("kind", "code"),
    [(PosetrackError, 1), (RecordingError, 1), (ResultError, 1), (RenderingError, 1), (UsageError, 2)],
)
def test_exit_codes(kind: type[PosetrackError], code: int) -> None:
    assert kind("x").exit_code == code


def test_the_nearest_name_or_else_all_of_them() -> None:
    assert nearest_name("partcles", ["poses", "particles"]) == "did you mean 'particles'?"
    assert nearest_name("qqqq", ["b", "a"]) == "known: a, b"
