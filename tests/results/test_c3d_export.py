"""Markers of C3D, read back by ezc3d."""

from __future__ import annotations

import builtins
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from posetrack_cli.errors import ResultError, UsageError
from posetrack_cli.results import ResultWriter, Status, read_result
from posetrack_cli.results.export import c3d as writing
from posetrack_cli.results.export.export import export_file
from posetrack_cli.results.export.source import export_source
from support.results import CAMERA, RUN, SUBJECT, make_estimate

FRAMES, DROPPED = 12, 5
ROUNDING = 1e-6  # of single precision, relative


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """A result in which one frame is missing and every seventh is lost."""
    with ResultWriter(tmp_path / "r.mcap", SUBJECT, CAMERA, RUN) as writer:
        for index in range(FRAMES):
            if index != DROPPED:
                writer.write(make_estimate(index))
        writer.finish({})
    return tmp_path / "r.mcap"


def test_markers_come_back_and_what_was_not_seen_is_marked(path: Path) -> None:
    ezc3d = pytest.importorskip("ezc3d", reason="ezc3d, of the extra c3d, is not installed")
    notes = export_file(export_source(read_result(path)), "c3d", path.with_suffix(".c3d"))
    assert notes == ("1 of 12 frames at 30 Hz have no estimate: their markers are not seen",)
    file = ezc3d.c3d(str(path.with_suffix(".c3d")))
    about: Any = file["parameters"]["POINT"]
    assert about["LABELS"]["value"] == list(SUBJECT.point_names)
    assert about["UNITS"]["value"] == ["mm"]
    assert (about["X_SCREEN"]["value"], about["Y_SCREEN"]["value"]) == (["+X"], ["-Y"])
    assert about["RATE"]["value"][0] == pytest.approx(30.0, rel=ROUNDING)
    points, residuals = file["data"]["points"], file["data"]["meta_points"]["residuals"][0]
    assert points.shape == (4, len(SUBJECT.point_names), FRAMES)
    for index in range(FRAMES):
        seen = index != DROPPED and make_estimate(index).status is not Status.LOST
        assert set(residuals[:, index]) == {0.0 if seen else -1.0}
        if seen:
            np.testing.assert_allclose(points[:3, :, index].T, make_estimate(index).points, rtol=ROUNDING)


def test_what_c3d_cannot_hold_is_told(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("ezc3d", reason="ezc3d, of the extra c3d, is not installed")
    source = export_source(read_result(path))
    for name, most, message in (
        ("MOST_FRAMES", 11, "too many frames for C3D, found 12, expected at most 11"),
        ("MOST_MARKERS", 3, "too many points for C3D, found 4"),
        ("LONGEST_NAME", 8, "too many bytes in a point's name for C3D, found 9"),
    ):
        with monkeypatch.context() as patch, pytest.raises(ResultError, match=message):
            patch.setattr(writing, name, most)
            export_file(source, "c3d", path.with_suffix(".c3d"))
    assert [each.name for each in path.parent.iterdir()] == ["r.mcap"]


def test_without_ezc3d_it_is_told_what_to_install(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found = builtins.__import__

    def without(name: str, *others: Any) -> Any:
        if name == "ezc3d":
            raise ImportError(name)
        return found(name, *others)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(UsageError, match=r"c3d needs ezc3d; pip install 'posetrack\[c3d\]'"):
        export_file(export_source(read_result(path)), "c3d", path.with_suffix(".c3d"))
