"""``posetrack view`` end to end, on a small recording whose results are made from its truth."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from posetrack_cli.cli.main import run
from posetrack_cli.errors import RenderingError
from posetrack_cli.recording.opening import open_recording
from posetrack_cli.recording.recording import Recording
from posetrack_cli.rendering import devices
from posetrack_cli.rendering.port import RenderingDevice
from posetrack_cli.results import ResultWriter, Subject
from support.viewing import (
    lost_from,
    make_folder,
    make_recording,
    make_result,
    moved,
    pictures_of,
    truth_of,
    write_camera,
)

FRAMES = 6
CAPTION_PX = 18
COMMAND = [sys.executable, "-m", "posetrack_cli.cli.main"]
LOST_RED = np.array([60, 60, 255])
GREEN = np.array([120, 255, 120])
CODEC_LOSS = 60
"""What the video codec may change a colour by at an edge."""


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_recording(tmp_path_factory.mktemp("made") / "hand.mcap", FRAMES)


@pytest.fixture(scope="module")
def opened(recording: Path) -> Recording:
    return open_recording(recording)


@pytest.fixture(scope="module")
def result(recording: Path, opened: Recording) -> Path:
    """Beside its recording, where it is found; it carries the truth and agrees with it."""
    return make_result(recording.with_name("result.mcap"), opened, with_truth=True)


def view(*arguments: object) -> int:
    return run(["view", *map(str, arguments)])


def is_colour(picture: np.ndarray, colour: np.ndarray, loss: int = 2) -> np.ndarray:
    return (np.abs(picture.astype(int) - colour) <= loss).all(axis=-1)


def one_line(capsys: pytest.CaptureFixture[str]) -> str:
    """The one line on standard error."""
    lines = [line for line in capsys.readouterr().err.splitlines() if line.strip()]
    assert len(lines) == 1, lines
    return lines[0]


def test_a_video_of_every_frame_with_the_hand_on_its_joints(
    result: Path, opened: Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "v.mp4"
    assert view(result, "-o", out) == 0
    assert capsys.readouterr().out == f"{FRAMES} frames: {out}\n"
    played = pictures_of(out)
    assert len(played) == FRAMES
    assert played[0].shape == (424 + CAPTION_PX, 3 * 512, 3)
    for picture, truth in zip(played, truth_of(opened), strict=True):
        rendered = picture[:424, 512:1024]
        pixels = np.rint(opened.cameras[0].pixels_from_points(truth.points)[0]).astype(int)
        inner = pixels[[0, 1, 2, 5, 9, 13, 17]]  # wrist and knuckles, well inside the skin
        assert (rendered[inner[:, 1], inner[:, 0]].max(axis=1) > CODEC_LOSS).all()
        assert (rendered[:40] < CODEC_LOSS).all(), "no hand at the upper edge"
    assert cv2.VideoCapture(str(out)).get(cv2.CAP_PROP_FPS) == pytest.approx(30.0, abs=0.1)


def test_without_opengl_the_processor_draws(
    result: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Unless an EGL device is asked for."""

    def missing(index: int | None = None) -> RenderingDevice:
        raise RenderingError("no headless context", where="OpenGL")

    monkeypatch.setattr(devices, "open_device", missing)
    chosen = ("--select", "0,3", "--layout", "over")
    assert view(result, "-o", tmp_path / "a.png", *chosen) == 0
    assert view(result, "-o", tmp_path / "b.png", *chosen, "--device", "cpu") == 0
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    capsys.readouterr()
    assert view(result, "-o", tmp_path / "c.png", *chosen, "--device", "0") == 1
    assert "no headless context" in one_line(capsys)


def test_chosen_frames_as_numbered_pictures(result: Path, tmp_path: Path) -> None:
    assert view(result, "-o", tmp_path / "p", "--select", "1:6:2,0", "--layout", "over") == 0
    names = sorted(path.name for path in (tmp_path / "p").iterdir())
    assert names == [f"frame_{index:06d}.png" for index in (0, 1, 3, 5)]
    assert cv2.imread(str(tmp_path / "p" / names[0])).shape == (424 + CAPTION_PX, 512, 3)


def test_the_paper_s_sheet(result: Path, opened: Recording, tmp_path: Path) -> None:
    """Observed above, rendered below, cut out around the hand: both halves show the same region."""
    out = tmp_path / "s.png"
    assert view(result, "-o", out, "--layout", "paper", "--select", "0,3") == 0
    sheet = cv2.imread(str(out))
    column = sheet[:, : (sheet.shape[1] - 6) // 2]
    rows = column.shape[0] % (2 * CAPTION_PX)  # of the caption: what both halves leave
    half = (column.shape[0] - CAPTION_PX) // 2 if rows else column.shape[0] // 2
    observed, rendered = column[:half], column[half : 2 * half]
    skin = rendered.any(axis=2)
    assert 0.1 < skin.mean() < 0.6, "the hand fills the part"
    red = observed[..., 2].astype(int) - observed[..., 0]
    assert np.median(red[skin]) > 100, "where the hand is drawn, the near hand was observed"


def test_two_results_beside_each_other(
    result: Path, recording: Path, opened: Recording, tmp_path: Path
) -> None:
    other = make_result(recording.with_name("other.mcap"), opened, moved(40.0))
    assert view(result, other, "-o", tmp_path / "p", "--select", "2") == 0
    picture = cv2.imread(str(tmp_path / "p" / "frame_000002.png"))
    assert picture.shape == (424 + 2 * CAPTION_PX, 2 * 512, 3)
    truth = truth_of(opened)[2]
    x, y = np.rint(opened.cameras[0].pixels_from_points(truth.points[9])[0]).astype(int)
    left, right = (
        picture[y, x].astype(int),
        picture[y, 512 + x + round(40 * 365 / truth.points[9][2])].astype(int),
    )
    assert left[2] > left[0] and right[0] > right[2], "the second hand is blue, and 40 mm further right"


def test_truth_and_skeleton(result: Path, recording: Path, opened: Recording, tmp_path: Path) -> None:
    wrong = make_result(recording.with_name("wrong.mcap"), opened, moved(30.0), with_truth=True)
    options = ["--select", "2", "--layout", "over"]
    counts = []
    for extra in ([], ["--show-truth"], ["--skeleton"]):
        assert view(wrong, "-o", tmp_path / "p", *options, *extra, "--overwrite") == 0
        picture = cv2.imread(str(tmp_path / "p" / "frame_000002.png"))[:-CAPTION_PX]
        counts.append(
            (is_colour(picture, GREEN).sum(), is_colour(picture, np.array([60, 60, 255]), 60).sum())
        )
    assert counts[0][0] == 0 < counts[1][0]
    paper = ["--layout", "paper", "--select", "2", "--show-truth", "--overwrite"]
    assert view(wrong, "-o", tmp_path / "p", *paper) == 0  # rendered below what was observed: truth, too
    assert is_colour(cv2.imread(str(tmp_path / "p" / "frame_000002.png"))[:-CAPTION_PX], GREEN).any()
    assert counts[2][1] > counts[0][1] + 20, "the x axis is red"


def test_a_head_is_drawn_by_its_points_and_axes(opened: Recording, recording: Path, tmp_path: Path) -> None:
    """Every subject can be drawn: of a head there is no mesh, but points and the axes of its pose."""
    camera, path = opened.cameras[0], recording.with_name("head.mcap")
    points = np.array([[0.0, 0.0, 600.0], [60.0, 0.0, 600.0], [0.0, -60.0, 600.0]])
    record = {f"input.{key}": value for key, value in opened.identity().items()}
    subject = Subject("head", camera.name, (), ("nose", "left", "brow"), (-1, -1, -1))
    facing = {"position": points[0], "quaternion": np.array([1.0, 0.0, 0.0, 0.0]), "points": points}
    with ResultWriter(path, subject, camera, record) as writer:
        for truth in truth_of(opened)[:2]:
            none = {"shape": np.empty(0), "pose_rate": None, "twist": None, "twist_variance": None}
            writer.write(replace(truth, pose_variance=np.zeros(6), **facing, **none))
        writer.finish({})
    assert view(path, "-o", tmp_path / "p") == 0
    rendered = cv2.imread(str(tmp_path / "p" / "frame_000001.png"))[:424, 512:1024]
    for point in points[1:]:
        x, y = np.rint(camera.pixels_from_points(point)[0]).astype(int)
        assert rendered[y, x].any()
    x, y = np.rint(camera.pixels_from_points(points[0] + [30.0, 0.0, 0.0])[0]).astype(int)
    assert is_colour(rendered[y, x], LOST_RED), (
        "the x axis, red, points to the head's left, right in the image"
    )


def test_lost_frames_are_marked(recording: Path, opened: Recording, tmp_path: Path) -> None:
    lost = make_result(recording.with_name("lost.mcap"), opened, lost_from(3))
    assert view(lost, "-o", tmp_path / "p", "--layout", "over") == 0
    borders = [
        bool(is_colour(cv2.imread(str(tmp_path / "p" / f"frame_{index:06d}.png"))[0], LOST_RED).all())
        for index in range(FRAMES)
    ]
    assert borders == [False] * 3 + [True] * 3


def test_scale_crop_and_range(result: Path, tmp_path: Path) -> None:
    sizes = {}
    for name, options in {
        "full": ["--zoom", "0.5"],
        "hand": ["--crop", "hand", "--zoom", "1"],
        "large": ["--crop", "hand", "--zoom", "2"],
    }.items():
        assert view(result, "-o", tmp_path / name, "--select", "1", "--layout", "over", *options) == 0
        sizes[name] = cv2.imread(str(tmp_path / name / "frame_000001.png")).shape
    assert sizes["full"][:2] == (212 + 2 * CAPTION_PX, 256)
    assert sizes["large"][1] == 2 * sizes["hand"][1] and sizes["hand"][1] < 400
    for name, limits in {"near": ("600", "700"), "wide": ("100", "4000")}.items():
        assert view(result, "-o", tmp_path / name, "--select", "1", "--range-mm", *limits) == 0
    near, wide = (cv2.imread(str(tmp_path / n / "frame_000001.png"))[:424, :512] for n in ("near", "wide"))
    assert (near != wide).any(axis=2).mean() > 0.3


def test_a_folder_needs_no_options_again_nor_its_camera_file(
    opened: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = make_folder(tmp_path / "images", opened, camera=False)
    camera = write_camera(tmp_path / "mine.toml", opened.cameras[0])
    options = ["--fps", "30", "--camera", str(camera)]
    tracked = tmp_path / "r.mcap"
    quick = ["--particles", "8", "--hand-side", "right", "--shape", "average", "--init", "center"]
    assert run(["hand", "run", str(folder), "-o", str(tracked), *quick, *options]) == 0
    monkeypatch.chdir("/")
    assert view(tracked, "-o", tmp_path / "v.mp4", "--camera", camera) == 0
    assert len(pictures_of(tmp_path / "v.mp4")) == FRAMES
    camera.unlink()
    assert view(tracked, "-o", tmp_path / "w.mp4") == 0  # the result holds what it said
    assert len(pictures_of(tmp_path / "w.mp4")) == FRAMES


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["nowhere.mcap", "-o", "v.mp4"], 1, "nowhere.mcap"),
        (["RECORDING", "-o", "v.mp4"], 1, "not a posetrack result"),
        (["RESULT", "-o", "v.avi"], 2, "expected FILE.mp4, FILE.png, FILE.mcap or a folder"),
        (["RESULT", "-o", "RESULT"], 2, "already exists"),
        (["RESULT", "-o", "v.mp4", "--select", "77"], 2, "expected frames from 0 to 5"),
        (["RESULT", "-o", "v.mp4", "--select", "best"], 2, "invalid --select"),
        (["RESULT", "-o", "v.mp4", "--range-mm", "9", "1"], 2, "expected 0 <= NEAR < FAR"),
        (["RESULT", "-o", "v.mp4", "--layout", "side-by-side"], 2, "requires two results"),
        (["RESULT", "RESULT", "RESULT", "-o", "v.mp4"], 2, "at most 2"),
        (["RESULT", "-o", "v.mp4", "--recording", "RESULT"], 1, "not the recording"),
        (["RESULT", "-o", "v.mp4", "--any-recording"], 2, "--any-recording requires --recording"),
        (["RESULT", "-o", "v.mp4", "--fps", "3"], 2, "does not apply to an MCAP file"),
        (["RESULT", "-o", "v.mp4", "--device", "99"], 1, "no headless context"),
        (["RESULT", "-o", "v.mp4", "--zoom", "0"], 2, "--zoom"),
        (["RESULT", "-o", "v.mp4", "--zoom", "nan"], 2, "nan is not a finite number"),
        (["RESULT", "-o", "v.mp4", "--rate", "nan"], 2, "nan is not a finite number"),
        (["RESULT", "-o", "-"], 2, "pictures cannot be written to standard output"),
    ],
)
def test_what_cannot_be_drawn_is_one_line(
    result: Path,
    recording: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    code: int,
    words: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    names = {"RESULT": str(result), "RECORDING": str(recording)}
    assert view(*(names.get(argument, argument) for argument in arguments)) == code
    assert words in one_line(capsys)
    assert list(tmp_path.iterdir()) == []


def test_a_missing_recording_says_where_it_looked(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    alone, gone = tmp_path / "a" / "b" / "r.mcap", tmp_path / "hand.mcap"
    alone.parent.mkdir(parents=True)
    gone.write_bytes(recording.read_bytes())
    make_result(alone, open_recording(gone))
    gone.unlink()
    monkeypatch.chdir(tmp_path)
    assert view(alone, "-o", tmp_path / "v.mp4") == 1
    line = one_line(capsys)
    assert "recording 'hand.mcap' not found" in line and "--recording" in line
    assert f"at {gone}, next to {alone}, in a parent folder or in the working directory" in line


def test_results_of_different_recordings_are_not_drawn_together(
    result: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = open_recording(make_recording(tmp_path / "other.mcap", 3))
    second = make_result(tmp_path / "second.mcap", other)
    assert view(result, second, "-o", tmp_path / "v.mp4") == 2
    assert "results belong to different recordings" in one_line(capsys)


def test_a_converted_recording_serves_when_any_will_do(
    result: Path, recording: Path, opened: Recording, tmp_path: Path
) -> None:
    copy = tmp_path / "copy.mcap"
    assert run(["convert", str(recording), "-o", str(copy)]) == 0
    arguments = [result, "-o", tmp_path / "v.mp4", "--recording", copy]
    assert view(*arguments) == 1
    assert view(*arguments, "--any-recording") == 0
    assert len(pictures_of(tmp_path / "v.mp4")) == FRAMES


def test_an_existing_output_is_replaced_only_when_asked(
    result: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "v.mp4"
    out.write_bytes(b"mine")
    assert view(result, "-o", out) == 2 and out.read_bytes() == b"mine"
    assert "--overwrite" in one_line(capsys)
    assert view(result, "-o", out, "--overwrite", "--select", "0") == 0
    assert len(pictures_of(out)) == 1


def test_a_truncated_result_is_drawn_as_far_as_it_goes(
    opened: Recording, recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """What a killed run leaves: whole chunks, no footer."""
    many = make_recording(tmp_path / "many.mcap", 25)
    whole = make_result(tmp_path / "whole.mcap", open_recording(many))
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole.read_bytes()[: int(0.6 * whole.stat().st_size)])
    assert view(cut, "-o", tmp_path / "v.mp4", "--layout", "over", "--zoom", "0.25") == 3
    captured = capsys.readouterr()
    drawn = len(pictures_of(tmp_path / "v.mp4"))
    assert 0 < drawn < 25 and captured.out.startswith(f"{drawn} frames: ")
    assert "cut.mcap: " in captured.err and "truncated" in captured.err


def test_frames_that_the_recording_lacks_are_counted(
    opened: Recording, result: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    short = make_recording(tmp_path / "short.mcap", 4)
    arguments = [result, "-o", tmp_path / "v.mp4", "--recording", short, "--any-recording"]
    assert view(*arguments) == 3
    captured = capsys.readouterr()
    assert captured.out.startswith("4 frames: ")
    assert "estimates without a frame in the recording: 2" in captured.err


def test_a_recording_of_other_frames_draws_nothing_and_leaves_nothing(
    opened: Recording, result: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    far = make_result(
        tmp_path / "far.mcap",
        opened,
        lambda e: replace(e, stamp_ns=e.stamp_ns + 10**12, frame_index=e.frame_index + 1000),
    )
    arguments = [far, "-o", tmp_path / "v.mp4", "--recording", opened.path]
    assert view(*arguments) == 1
    assert "no frame can be drawn" in one_line(capsys)
    assert not (tmp_path / "v.mp4").exists()


def test_an_empty_result_and_one_of_a_single_frame(
    opened: Recording, recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    empty = make_result(recording.with_name("empty.mcap"), opened, keep=lambda e: False)
    assert view(empty, "-o", tmp_path / "v.mp4") == 2
    assert "no frame to draw" in one_line(capsys)
    single = make_result(recording.with_name("single.mcap"), opened, keep=lambda e: e.frame_index == 4)
    assert view(single, "-o", tmp_path / "v.mp4") == 0
    assert len(pictures_of(tmp_path / "v.mp4")) == 1


def test_ctrl_c_leaves_a_video_of_what_was_drawn(tmp_path: Path) -> None:
    recording = make_recording(tmp_path / "long.mcap", 40)
    result = make_result(tmp_path / "result.mcap", open_recording(recording))
    out, part = tmp_path / "v.mp4", tmp_path / "v.part.mp4"
    arguments = ["view", str(result), "-o", str(out), "--zoom", "4"]
    process = subprocess.Popen([*COMMAND, *arguments], stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 60
    while not (part.exists() and part.stat().st_size > 0) and time.monotonic() < deadline:
        time.sleep(0.02)
    os.kill(process.pid, signal.SIGINT)
    _, said = process.communicate(timeout=60)
    assert process.returncode == 130, said
    drawn = len(pictures_of(out))
    assert 0 < drawn < 40 and f"interrupted after {drawn} of 40 frames: {out}" in said
    assert not part.exists()
