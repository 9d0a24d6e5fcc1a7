"""Pictures of heads: what is drawn lies on what the cameras saw, lens distortion and all."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from posetrack_cli.cli.main import run
from posetrack_cli.evaluation.reading.recording_of import required_recording
from posetrack_cli.evaluation.viewing.drawing import AXIS_COLOURS, AXIS_MM, LOST, SKIN, TOGETHER, TRUTH
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.head.subject import head_subject
from posetrack_cli.mcap.stream import McapFile
from posetrack_cli.recording.base import TruthMessage
from posetrack_cli.recording.camera_file import camera_file_text
from posetrack_cli.recording.opening import open_recording
from posetrack_cli.results import Estimate, ResultWriter, Status, read_result
from posetrack_cli.results.estimate_json import ESTIMATE_SCHEMA_NAME, estimate_to_json

FPS, FRAMES = 25.0, 3
TURNED = cv2.Rodrigues(np.array([0.02, 0.17, 0.03]))[0]
PLACE = tuple(map(tuple, np.column_stack([TURNED, [-118.0, 2.0, 20.0]]).tolist()))
BENT = (-0.4, 0.1, 0.002, -0.001, 0.0)
"""Shifts the outer points by 4 pixels."""
CAMERAS = (
    Camera(320, 240, 400.0, 402.0, 160.5, 118.0, BENT, name="left"),
    Camera(320, 240, 405.0, 400.0, 158.0, 121.5, BENT, name="right", camera_T_reference=PLACE),
)
POINTS = np.array([[x, y, 600.0] for x in (-150.0, -70.0, 0.0, 70.0, 150.0) for y in (-90.0, 90.0)])
DOT_PX = 4


def seen(camera: Camera, points: np.ndarray, *, bent: bool) -> np.ndarray:
    """Pixels (P, 2) by OpenCV, with or without the lens."""
    place = np.array(camera.camera_T_reference)
    turn, _ = cv2.Rodrigues(place[:, :3])
    lens = np.array(camera.distortion) if bent else np.zeros(5)
    return cv2.projectPoints(points, turn, place[:, 3], camera.matrix, lens)[0][:, 0]


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """White dots on dark ground where bent lenses see the points."""
    folder = tmp_path_factory.mktemp("seen") / "dots"
    for camera in CAMERAS:
        (folder / camera.name).mkdir(parents=True)
        image = np.full((camera.height, camera.width), 20, np.uint8)
        for x, y in np.rint(16 * seen(camera, POINTS, bent=True)).astype(int).tolist():
            cv2.circle(image, (x, y), DOT_PX << 4, 255, -1, cv2.LINE_AA, 4)
        for index in range(FRAMES):
            cv2.imwrite(str(folder / camera.name / f"{index}.png"), image)
    (folder / "camera.toml").write_text(camera_file_text(CAMERAS))
    return folder


def estimate(index: int, status: Status) -> Estimate:
    return Estimate(
        frame_index=index,
        stamp_ns=index * 40_000_000,
        status=status,
        confidence=0.5,
        position=np.array([0.0, 0.0, 600.0]),
        quaternion=np.array([1.0, 0.0, 0.0, 0.0]),  # looks at the camera
        shape=np.zeros(0),
        pose_rate=None,
        twist=None,
        pose_variance=None,
        twist_variance=None,
        points=POINTS,
        effective_sample_size=None,
        resampled=False,
    )


@pytest.fixture
def result(recording: Path, tmp_path: Path) -> Callable[..., Path]:
    def write(
        name: str = "r.mcap", cameras: tuple[Camera, ...] = CAMERAS, true_points: np.ndarray | None = None
    ) -> Path:
        opened = open_recording(recording, "grey", fps=FPS)
        record = {f"input.{key}": value for key, value in opened.identity().items()}
        record |= {"tracker": "head-stereo", "configuration": "{}"}
        statuses = (Status.TRACKING, Status.LOST, Status.REINITIALISED)
        subject = head_subject("left", 0)
        with ResultWriter(tmp_path / name, subject, cameras[0], record, others=cameras[1:]) as writer:
            for index, status in enumerate(statuses):
                made = estimate(index, status)
                if true_points is not None:
                    data, topic = estimate_to_json(replace(made, points=true_points)), "/truth/head/estimate"
                    kind = (ESTIMATE_SCHEMA_NAME, "jsonschema", b"{}", "json")
                    writer.add_truth(TruthMessage(topic, *kind, made.stamp_ns, data))
                writer.write(made)
            writer.finish({})
        return tmp_path / name

    return write


def view(*arguments: object) -> int:
    return run(["view", *map(str, arguments)])


def test_what_is_drawn_lies_on_what_was_seen(
    result: Callable[..., Path], recording: Path, tmp_path: Path
) -> None:
    assert view(result(), "-o", tmp_path / "p", "--recording", recording, "--zoom", 1) == 0
    picture = cv2.imread(str(tmp_path / "p" / "frame_000000.png"))
    assert picture.shape[:2] == (240 + 18, 640)
    for camera, left in zip(CAMERAS, (0, 320), strict=True):
        half = picture[:240, left : left + 320]
        for x, y in np.rint(seen(camera, POINTS, bent=False)).astype(int):
            assert np.abs(half[y, x].astype(int) - SKIN).max() <= 30, "a dot of the estimate"
            around = [half[y, x - 3], half[y, x + 3], half[y - 3, x], half[y + 3, x]]
            assert np.min(np.max(around, axis=1)) > 120, "amid what the camera saw"


@pytest.mark.parametrize("apart_mm", [0.0, 20.0])
def test_truth_and_estimate_are_both_seen(
    result: Callable[..., Path], recording: Path, tmp_path: Path, apart_mm: float
) -> None:
    """Also where they are the same: the estimate lies on the truth, which has a rim around it."""
    true_points = POINTS + np.array([0.0, apart_mm, 0.0])
    path = result(true_points=true_points)
    options = ("--recording", recording, "--zoom", 4, "--select", "0", "--show-truth")
    assert view(path, "-o", tmp_path / "p", *options) == 0
    picture = cv2.imread(str(tmp_path / "p" / "frame_000000.png"))
    for points, colour, off_px in ((POINTS, SKIN, 0), (true_points, TRUTH, 5)):
        for x, y in np.rint(4 * (seen(CAMERAS[0], points, bent=False) + 0.5)).astype(int):
            around = picture[y - 1 : y + 2, x - off_px - 1 : x - off_px + 2].reshape(-1, 3)
            assert np.abs(around.astype(int) - colour).max(axis=1).min() <= 30


def test_several_heads_are_drawn_into_one_picture(recording: Path, tmp_path: Path) -> None:
    opened = open_recording(recording, "grey", fps=FPS)
    record = {f"input.{key}": value for key, value in opened.identity().items()} | {"configuration": "{}"}
    subjects = [replace(head_subject("left", 0), label=label) for label in "12"]
    middle = np.array([0.0, 0.0, 600.0])
    # two heads of half the size, the second with points between those of the first
    shown = [
        replace(estimate(0, Status.TRACKING), points=scale * (POINTS - middle) + middle) for scale in (1, 0.5)
    ]
    path = tmp_path / "two.mcap"
    with ResultWriter(path, subjects, CAMERAS[0], record, others=CAMERAS[1:]) as writer:
        writer.write_frame(shown)
        writer.finish({})
    assert view(path, "-o", tmp_path / "p", "--recording", recording, "--zoom", 1) == 0
    picture = cv2.imread(str(tmp_path / "p" / "frame_000000.png"))
    assert picture.shape[1] == 640
    for one, colour in zip(shown, TOGETHER, strict=False):
        x, y = np.rint(seen(CAMERAS[0], one.points, bent=False)[0]).astype(int)
        assert np.abs(picture[y, x].astype(int) - colour).max() <= 30
    assert view(path, "-o", tmp_path / "one", "--recording", recording, "--zoom", 1, "--of", "2") == 0
    alone = cv2.imread(str(tmp_path / "one" / "frame_000000.png"))
    assert len(alone) < len(picture)
    assert view(path, path, "-o", tmp_path / "p2", "--recording", recording) == 2
    assert view(path, "-o", tmp_path / "p.mcap", "--recording", recording) == 0
    topics = {channel.topic for _, channel in McapFile(tmp_path / "p.mcap").channels()}
    assert {"/head/1/points", "/head/2/points"} <= topics


def test_axes_point_where_the_head_does(result: Callable[..., Path], recording: Path, tmp_path: Path) -> None:
    assert view(result(), "-o", tmp_path / "p", "--recording", recording, "--zoom", 1) == 0
    picture = cv2.imread(str(tmp_path / "p" / "frame_000000.png"))
    # half a turn about x: the subject's left is the image's right, its up the image's up
    middles = np.array([[0.5 * AXIS_MM, 0.0, 600.0], [0.0, -0.5 * AXIS_MM, 600.0]])
    for camera, left in zip(CAMERAS, (0, 320), strict=True):
        pixels = np.rint(seen(camera, middles, bent=False)).astype(int)
        for (x, y), colour in zip(pixels, AXIS_COLOURS[:2], strict=True):
            assert np.abs(picture[y, left + x].astype(int) - colour).max() <= 30


def test_lost_frames_have_a_red_border(result: Callable[..., Path], recording: Path, tmp_path: Path) -> None:
    assert view(result(), "-o", tmp_path / "p", "--recording", recording) == 0
    corners = [tuple(cv2.imread(str(tmp_path / "p" / f"frame_00000{i}.png"))[0, 0]) for i in range(3)]
    assert corners[1] == LOST
    assert corners[0] != LOST and corners[2] != LOST


def test_two_results_are_below_each_other_and_crops_are_small(
    result: Callable[..., Path], recording: Path, tmp_path: Path
) -> None:
    a, b = result("a.mcap"), result("b.mcap")
    options = ("--recording", recording, "--select", "0", "--zoom", 1)
    assert view(a, b, "-o", tmp_path / "two.png", *options) == 0
    assert cv2.imread(str(tmp_path / "two.png")).shape == (2 * (240 + 18), 640, 3)
    assert view(a, "-o", tmp_path / "crop.png", *options, "--crop", "head") == 0
    height, width = cv2.imread(str(tmp_path / "crop.png")).shape[:2]
    # of 180 mm of points and 45 mm above and below, at 0.67 px/mm, and the caption
    assert 150 < height < 240 and width < 640


def test_it_is_found_beside_the_result(result: Callable[..., Path], recording: Path, tmp_path: Path) -> None:
    (tmp_path / "dots").symlink_to(recording)
    assert view(result(), "-o", tmp_path / "a.png", "--select", "0") == 0


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (["--layout", "segments"], "--layout segments requires depth images"),
        (["--range-mm", "1", "2"], "--range-mm requires depth images"),
        (["--missing", "3"], "--missing does not apply to a folder of images"),
        (["--show-truth"], "no ground truth in the result"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_what_a_head_has_not_is_one_line(
    result: Callable[..., Path],
    recording: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    options: list[str],
    expected: str,
) -> None:
    assert view(result(), "-o", tmp_path / "a.png", "--recording", recording, *options) != 0
    (line,) = capsys.readouterr().err.splitlines()
    assert expected in line


def test_other_images_are_refused(
    result: Callable[..., Path], recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    changed = tmp_path / "changed"
    for camera in CAMERAS:
        (changed / camera.name).mkdir(parents=True)
        for index in range(FRAMES):
            cv2.imwrite(str(changed / camera.name / f"{index}.png"), np.zeros((240, 320), np.uint8))
    (changed / "camera.toml").write_text(camera_file_text(CAMERAS))
    path = result()
    assert view(path, "-o", tmp_path / "a.png", "--recording", changed) == 1
    assert "not the recording of the result" in capsys.readouterr().err
    anyway = ("--any-recording", "--fps", FPS)
    assert view(path, "-o", tmp_path / "a.png", "--recording", changed, *anyway) == 0


def test_a_result_of_other_cameras_is_refused(
    result: Callable[..., Path], recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    moved = replace(CAMERAS[1], fx=410.0)
    a, b = result("a.mcap"), result("b.mcap", (CAMERAS[0], moved))
    assert view(a, b, "-o", tmp_path / "a.png", "--recording", recording) == 2
    assert "results have different cameras" in capsys.readouterr().err


def test_images_are_opened_as_the_run_did(result: Callable[..., Path], recording: Path) -> None:
    opened = required_recording(read_result(result()), recording)
    assert opened.cameras[0] == CAMERAS[0]
    places = [camera.camera_T_reference for camera in (opened.cameras[1], CAMERAS[1])]
    np.testing.assert_allclose(*places, atol=1e-12)  # a rotation from a file is made orthonormal
    assert replace(opened.cameras[1], camera_T_reference=PLACE) == CAMERAS[1]
    assert [frame.stamp_ns for frame in opened.frames()] == [0, 40_000_000, 80_000_000]
