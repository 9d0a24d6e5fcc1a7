"""The registry of sources: what is opened as what, and which options apply to it."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from posetrack_cli.cli.options import NAMES
from posetrack_cli.errors import RecordingError, ResultError, UsageError
from posetrack_cli.recording.opening import SOURCES, describe, open_recording
from posetrack_cli.recording.recording import ReadingOptions
from posetrack_cli.results.reader import read_result

OPENERS = [opener for source in SOURCES for opener in source.openers.values()]


def test_every_option_is_one_of_reading_and_applies_somewhere() -> None:
    applying = frozenset[str]().union(*(opener.options for opener in OPENERS))
    assert applying == ReadingOptions.__annotations__.keys()
    assert {*NAMES, "guess", "in_colour"} == applying


def test_options_that_exclude_each_other_both_apply_alone() -> None:
    for opener in OPENERS:
        assert {*opener.excluded.keys(), *opener.excluded.values()} <= opener.options


@pytest.mark.parametrize("pixels", ["depth", "grey"])
def test_what_is_not_there_is_said_before_any_option(tmp_path: Path, pixels: str) -> None:
    with pytest.raises(RecordingError, match="no such file or folder"):
        open_recording(tmp_path / "none", pixels, topic="/t", tolerance_ms=1.0)  # type: ignore[arg-type]
    with pytest.raises(RecordingError, match="no such file or folder"):
        describe(tmp_path / "none")


@pytest.mark.parametrize(
    ("name", "hint"),
    [
        ("https://example.org/face.mp4", "URLs are not supported: download the file first"),
        ("s3://bucket/a.mcap", "URLs are not supported: download the file first"),
        ("in/**/*.mcap", "for several recordings use posetrack batch with a pattern"),
    ],
)
def test_what_a_name_may_have_meant_is_told(name: str, hint: str) -> None:
    with pytest.raises(RecordingError, match="no such file or folder") as caught:
        open_recording(Path(name), "grey")
    assert str(caught.value).endswith(f"; {hint}")
    with pytest.raises(ResultError) as of_result:
        read_result(Path(name))
    assert ("URLs" in hint) == str(of_result.value).endswith(f"; {hint}")


def test_an_option_of_depth_is_refused_for_grey_and_the_other_way_round(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="--depth-unit-mm does not apply to a folder of images"):
        open_recording(tmp_path, "grey", depth_unit_mm=2.0)
    with pytest.raises(UsageError, match="--tolerance-ms does not apply to a folder of images"):
        open_recording(tmp_path, "depth", tolerance_ms=5.0)


def test_a_video_holds_no_depth(tmp_path: Path) -> None:
    (tmp_path / "v.mp4").write_bytes(b"\0\0\0\x20ftypisom")
    with pytest.raises(RecordingError, match=r"not a readable video"):
        open_recording(tmp_path / "v.mp4")
    (tmp_path / "notes").write_text("notes")
    with pytest.raises(RecordingError, match=r"not a recording, found an unknown file type, expected"):
        open_recording(tmp_path / "notes")
    video = cv2.VideoWriter(str(tmp_path / "v.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 30, (64, 48))
    video.write(np.zeros((48, 64, 3), np.uint8))
    video.release()
    hint = "video has no depth stream, .*; to track heads in videos use posetrack head mono"
    with pytest.raises(RecordingError, match=hint):
        open_recording(tmp_path / "v.avi")
