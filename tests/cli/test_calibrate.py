"""``posetrack calibrate stereo``: from images of a board to a recording that it opens, and wrong usage."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import CliRunner, Result

from posetrack_cli.cli.calibrate import calibrate
from posetrack_cli.errors import EXIT_DATA_LOST, EXIT_DONE, PosetrackError, RecordingError, UsageError
from posetrack_cli.recording.opening import open_recording
from support import boards as support

BOARD = ("--squares", "7x5", "--square-mm", "26", "--marker-mm", "19")


@pytest.fixture(scope="module")
def views(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("calibrate") / "views"
    return support.write_views(folder, support.CHARUCO, support.cameras(), support.poses(6))


def run(*arguments: object) -> Result:
    return CliRunner().invoke(calibrate, ["stereo", *map(str, arguments)], catch_exceptions=False)


def test_what_it_writes_opens_a_recording(views: Path, tmp_path: Path) -> None:
    recording = tmp_path / "recording"
    for side in ("left", "right"):
        (recording / side).mkdir(parents=True)
        cv2.imwrite(str(recording / side / "0.png"), np.zeros((support.HEIGHT, support.WIDTH), np.uint8))
    output = recording / "camera.toml"
    result = run(views, "-o", output, *BOARD)
    assert result.exit_code == EXIT_DONE
    assert "camera left: reprojection error 0." in result.stdout
    assert "left - right: epipolar error 0." in result.stdout
    assert f"{output}: cameras left, right" in result.stdout
    left, right = open_recording(recording, "grey", fps=30).cameras
    assert left.fx == pytest.approx(620.0, rel=0.02)
    assert right.camera_T_reference[0][3] == pytest.approx(-118.0, abs=3.0)
    text = output.read_text()
    with pytest.raises(UsageError, match="already exists"):
        run(views, "-o", output, *BOARD)
    assert run(views, "-o", output, *BOARD, "--overwrite").exit_code == EXIT_DONE
    assert output.read_text() == text, "the same images give the same file"


def test_images_that_cannot_be_decoded_are_told_and_change_the_exit_code(views: Path, tmp_path: Path) -> None:
    for image in views.glob("*/*.png"):
        (tmp_path / image.parent.name).mkdir(exist_ok=True)
        (tmp_path / image.parent.name / image.name).write_bytes(image.read_bytes())
    (tmp_path / "left" / "000.png").write_bytes(b"")
    result = run(tmp_path, "-o", tmp_path / "out.toml", *BOARD)
    assert result.exit_code == EXIT_DATA_LOST
    assert "image skipped, file is empty: 1" in result.stderr
    assert (tmp_path / "out.toml").exists()


def test_cameras_that_do_not_fit_together_are_not_written(views: Path, tmp_path: Path) -> None:
    names = sorted(image.name for image in (views / "left").iterdir())
    for side, shift in (("left", 0), ("right", 1)):
        (tmp_path / side).mkdir()
        for name, other in zip(names, names[shift:] + names[:shift], strict=True):
            (tmp_path / side / name).write_bytes((views / side / other).read_bytes())
    output = tmp_path / "out.toml"
    with pytest.raises(RecordingError, match="cameras are inconsistent, camera file not written"):
        run(tmp_path, "-o", output, *BOARD)
    assert not output.exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--squares", "7", "--square-mm", "26"), "invalid --squares, found '7'"),
        (("--squares", "2x5", "--square-mm", "26"), "invalid board, found 2x5 squares"),
        (("--squares", "7x5", "--square-mm", "-1"), "squares of -1 mm"),
        (("--squares", "7x5", "--square-mm", "26", "--marker-mm", "30"), "markers do not fit"),
        ((*BOARD, "--dictionary", "9X9"), "unknown dictionary '9X9'"),
        ((*BOARD, "--cameras", "left,up"), "no folder 'up'"),
    ],
)
def test_what_cannot_be_used_is_told_and_nothing_written(
    views: Path, tmp_path: Path, arguments: tuple[str, ...], message: str
) -> None:
    with pytest.raises(PosetrackError) as caught:
        run(views, "-o", tmp_path / "out.toml", *arguments)
    assert message in str(caught.value)
    assert list(tmp_path.iterdir()) == []
