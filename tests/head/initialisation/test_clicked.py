"""Clicked points: what their file may and may not hold."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from posetrack_cli.errors import PosetrackError, UsageError
from posetrack_cli.head.face.points import POINT_NAMES
from posetrack_cli.head.initialisation.clicked import read_clicked
from posetrack_cli.head.initialisation.stereo import complete_camera
from support.rig import LEFT, right_camera

CAMERAS = (LEFT, right_camera(0.17))


def written(tmp_path: Path, *lines: str) -> Path:
    path = tmp_path / "clicked.csv"
    path.write_text("\n".join(["camera,point,x,y", *lines]) + "\n")
    return path


def every_point(camera: str = "left") -> list[str]:
    return [f"{camera},{name},{100 + k},{200.5 + k}" for k, name in enumerate(POINT_NAMES)]


def test_points_are_read_by_name_in_any_order(tmp_path: Path) -> None:
    pixels = read_clicked(written(tmp_path, *reversed(every_point()), "right,left_nostril,7,8"), CAMERAS)
    np.testing.assert_array_equal(pixels[0], [[100 + k, 200.5 + k] for k in range(10)])
    np.testing.assert_array_equal(pixels[1, 7], [7.0, 8.0])
    assert np.isnan(pixels[1]).sum() == 18
    assert complete_camera(pixels) == 0


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("front,left_nostril,1,2", "unknown camera, found front"),
        ("left,left_nostrl,1,2", "did you mean 'left_nostril'"),
        ("left,left_nostril,640,2", "pixel outside the image, found 640, 2"),
        ("left,left_nostril,here,2", "is not a number, found 'here'"),
        ("left,left_nostril,nan,2", "is not finite"),
        ("left,left_nostril,5", "row does not fit the header"),
        ("left,left_nostril,1,2", "point clicked twice"),
    ],
)
def test_a_wrong_line_is_named(tmp_path: Path, line: str, said: str) -> None:
    with pytest.raises(PosetrackError, match=said) as caught:
        read_clicked(written(tmp_path, *every_point(), line), CAMERAS)
    assert "clicked.csv line 12" in str(caught.value)


def test_some_camera_must_have_all_ten(tmp_path: Path) -> None:
    with pytest.raises(PosetrackError, match="left without left_nostril"):
        lines = [line for line in every_point() if "left_nostril" not in line]
        read_clicked(written(tmp_path, *lines), CAMERAS)


def test_a_missing_file_and_another_table_are_refused(tmp_path: Path) -> None:
    with pytest.raises(
        UsageError, match="cannot be read, found No such file or directory; clicked points must be"
    ):
        read_clicked(tmp_path / "none.csv", CAMERAS)
    other = tmp_path / "other.csv"
    other.write_text("a,b\n1,2\n")
    with pytest.raises(UsageError, match="found a, b, expected camera, point, x, y"):
        read_clicked(other, CAMERAS)
