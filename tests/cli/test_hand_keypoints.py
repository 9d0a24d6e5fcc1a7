"""``posetrack hand run --keypoints`` end to end: what another program found leads to our pose, no further."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

import numpy as np
import pytest

from posetrack_cli.arrays import FloatArray
from posetrack_cli.cli.main import run
from posetrack_cli.hand.model.anatomy import JOINT_NAMES
from posetrack_cli.hand.model.kinematics import joint_positions
from posetrack_cli.outputs import part_path
from posetrack_cli.recording.opening import open_recording
from posetrack_cli.rendering.port import RenderingDevice
from posetrack_cli.results import load_arrays, read_result
from support.hand import KINECT
from support.hand_scene import FRAME_NS, HANDS, Stage, relaxed
from support.recordings import write_folder

FRAMES, TRACKED_MM = 10, 5.0
"""Mean error of the joints of a drawn hand that is tracked."""
NO_WORSE_MM = 1.0
"""What keypoints that are wrong may cost, mean error of a track of synthetic motion."""
NOISE_PX, NOISE_MM = 5.0, 8.0
SMALL = ("--particles", "48", "--hand-side", "right", "--scale", "1")
NEARER, FARTHER = (
    [relaxed(x + 2.0 * k, 60.0, z) for k in range(FRAMES)] for x, z in ((-110.0, 640.0), (140.0, 800.0))
)
"""Costs of two hands alike differ by .25 mm (sd, 24 such scenes); 160 mm of depth count .8 mm."""


def joints(poses: list[FloatArray]) -> FloatArray:
    return joint_positions(HANDS["right"].anatomy, np.array(poses))


@pytest.fixture(scope="module")
def two_hands(device: RenderingDevice, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two right hands alike side by side: what is nearer is taken where nothing else tells."""
    stage, rng = Stage(device, HANDS["right"]), np.random.default_rng(0)
    depths = [
        stage.depth(*poses) + rng.normal(0.0, 2.0, (424, 512)) for poses in zip(NEARER, FARTHER, strict=True)
    ]
    camera = f"fx = 365.0\nfy = 365.0\ncx = {KINECT.cx}\ncy = {KINECT.cy}\n"
    stamps = ["stamp_ns", *(str(k * FRAME_NS) for k in range(FRAMES))]
    folder = tmp_path_factory.mktemp("two") / "depth"
    return write_folder(folder, [d.astype(np.uint16) for d in depths], camera=camera, stamp_lines=stamps)


@pytest.fixture(scope="module")
def synthetic(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("synth") / "hand.mcap"
    command = [
        "hand",
        "synth",
        "--motion",
        "C",
        "--frames",
        "24",
        "--seed",
        "3",
        "--no-drops",
        "-o",
        str(path),
    ]
    assert run(command) == 0
    return path


@pytest.fixture(scope="module")
def silent(synthetic: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What is tracked of it without keypoints."""
    path = tmp_path_factory.mktemp("silent") / "r.mcap"
    assert track(synthetic, path) == 0
    return path


def pixels_file(path: Path, points: FloatArray, numbers: bool = True, seed: int = 0) -> Path:
    """Points (N, 21, 3), mm, as noisy pixels."""
    rng = np.random.default_rng(seed)
    pixels = KINECT.pixels_from_points(points)[0] + NOISE_PX * rng.standard_normal((len(points), 21, 2))
    header = ",".join([*("frame" if numbers else "stamp_ns",), *(f"x{k},y{k}" for k in range(21))])
    rows = [
        ",".join(map(str, [k if numbers else k * FRAME_NS, *row.ravel().round(2)]))
        for k, row in enumerate(pixels)
    ]
    path.write_text("\n".join([header, *rows]) + "\n")
    return path


def track(recording: Path, output: Path, *options: object) -> int:
    return run(["hand", "run", str(recording), "-o", str(output), *SMALL, *map(str, options)])


def errors(result: Path, truth: FloatArray) -> FloatArray:
    """Mean error of the joints in each frame, mm."""
    points = load_arrays(result)["points"]
    return np.asarray(np.linalg.norm(points - truth[: len(points)], axis=2).mean(axis=1))


def test_the_hand_that_is_told_is_tracked_from_the_first_frame(
    two_hands: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert track(two_hands, tmp_path / "silent.mcap") == 0
    assert errors(tmp_path / "silent.mcap", joints(NEARER)).max() < TRACKED_MM
    keypoints = pixels_file(tmp_path / "k.csv", joints(FARTHER))
    capsys.readouterr()
    assert track(two_hands, tmp_path / "told.mcap", "--keypoints", keypoints) == 0
    assert errors(tmp_path / "told.mcap", joints(FARTHER)).max() < TRACKED_MM
    said = capsys.readouterr().err
    assert f"{keypoints}: 10 hands of 21 points by frame number, in px, no side labels" in said
    record = read_result(tmp_path / "told.mcap").run
    assert record["keypoints"] == "k.csv" and len(record["keypoints.sha256"]) == 64
    assert "keypoints" not in read_result(tmp_path / "silent.mcap").run


def test_labels_choose_among_the_hands_of_a_frame(two_hands: Path, tmp_path: Path) -> None:
    """Both are told, in metres; that which is labelled as the other side is left."""
    entries = [
        {
            "stamp_ns": k * FRAME_NS,
            "hands": [{"landmarks": near, "side": "left"}, {"landmarks": far, "side": "right"}],
        }
        for k, (near, far) in enumerate(zip(joints(NEARER) / 1000, joints(FARTHER) / 1000, strict=True))
        for near, far in [(near.tolist(), far.tolist())]
    ]
    (tmp_path / "k.json").write_text(json.dumps({"unit": "m", "frames": entries}))
    assert track(two_hands, tmp_path / "a.mcap", "--keypoints", tmp_path / "k.json", "--end", 4) == 0
    assert errors(tmp_path / "a.mcap", joints(FARTHER)).max() < TRACKED_MM
    swapped = ("--keypoints", tmp_path / "k.json", "--keypoints-swap-sides", "--end", 4)
    assert track(two_hands, tmp_path / "b.mcap", *swapped) == 0
    assert errors(tmp_path / "b.mcap", joints(NEARER)).max() < TRACKED_MM


def test_an_export_of_a_result_leads_another_run(two_hands: Path, tmp_path: Path) -> None:
    keypoints = pixels_file(tmp_path / "k.csv", joints(FARTHER), numbers=False)
    assert track(two_hands, tmp_path / "first.mcap", "--keypoints", keypoints) == 0
    for name in ("e.csv", "e.json"):
        assert run(["export", str(tmp_path / "first.mcap"), "-o", str(tmp_path / name)]) == 0
        output = tmp_path / f"{name}.mcap"
        assert track(two_hands, output, "--keypoints", tmp_path / name, "--end", 4) == 0
        assert errors(output, joints(FARTHER)).max() < TRACKED_MM
        assert read_result(output).run["keypoints.unit"] == "mm"


def wrong_points(kind: str, truth: FloatArray) -> FloatArray:
    """Points (N, 21, 3), mm: noisy; a fifth of the frames elsewhere or mixed up; or all anywhere."""
    rng = np.random.default_rng(7)
    points = truth + NOISE_MM * rng.standard_normal(truth.shape)
    some = rng.random(len(truth)) < 0.2
    if kind == "elsewhere":
        points[some] += rng.uniform(100.0, 300.0, (int(some.sum()), 1, 3))
    elif kind == "garbage":
        points = rng.uniform([-200.0, -200.0, 500.0], [200.0, 200.0, 900.0], truth.shape)
    else:
        points[some] = points[some][:, rng.permutation(21)]
    return points


@pytest.mark.parametrize("kind", ["elsewhere", "garbage", "mixed up"])
def test_keypoints_that_are_wrong_cost_next_to_nothing(
    synthetic: Path, silent: Path, tmp_path: Path, kind: str
) -> None:
    truth = load_arrays(silent, "/truth/hand/estimate")
    stamps = [frame.stamp_ns for frame in open_recording(synthetic).frames()]
    header = ",".join(["stamp_ns", *(f"{name}_{axis}_mm" for name in JOINT_NAMES for axis in "xyz")])
    points = wrong_points(kind, truth["points"])
    rows = [",".join(map(str, [stamp, *row.ravel()])) for stamp, row in zip(stamps, points, strict=True)]
    (tmp_path / "k.csv").write_text("\n".join([header, *rows]) + "\n")
    assert track(synthetic, tmp_path / "told.mcap", "--keypoints", tmp_path / "k.csv") == 0
    usual, found = (errors(path, truth["points"]).mean() for path in (silent, tmp_path / "told.mcap"))
    assert found < usual + NO_WORSE_MM


def test_a_run_resumes_with_the_same_keypoints_only(
    two_hands: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    keypoints = pixels_file(tmp_path / "k.csv", joints(FARTHER))
    flushed = ("--keypoints", keypoints, "--set", "output.flush_frames=2", "--end", 6)
    whole, output = tmp_path / "whole.mcap", tmp_path / "r.mcap"
    assert track(two_hands, whole, *flushed) == 0
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("posetrack_cli.cli.hand.stop_signals", _stopping_after(3))
        assert track(two_hands, output, *flushed) == 130
    assert part_path(output).is_file()
    text = keypoints.read_text()
    keypoints.write_text(text.replace("\n3,", "\n3,1", 1))
    capsys.readouterr()
    assert track(two_hands, output, *flushed, "--resume") == 2
    assert "keypoints.sha256" in capsys.readouterr().err
    assert track(two_hands, output, *flushed[2:], "--resume") == 2
    keypoints.write_text(text)
    assert track(two_hands, output, *flushed, "--resume") == 0
    assert output.read_bytes() == whole.read_bytes()


def _stopping_after(frames: int) -> Callable[[object], AbstractContextManager[Callable[[], bool]]]:
    """What stands for Ctrl-C after some frames."""

    @contextmanager
    def signals(_: object) -> Iterator[Callable[[], bool]]:
        asked = iter(range(frames))
        yield lambda: next(asked, None) is None

    return signals


@pytest.mark.parametrize(
    ("options", "line"),
    [
        (("--keypoints", "none.csv"), r"none\.csv: cannot be read, found No such file or directory"),
        (("--keypoints-unit", "px"), "--keypoints-unit requires --keypoints"),
        (("--keypoints-swap-sides",), "--keypoints-swap-sides requires --keypoints"),
    ],
)
def test_what_cannot_be_meant_is_one_line(
    two_hands: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], options: tuple[str, ...], line: str
) -> None:
    assert track(two_hands, tmp_path / "r.mcap", *options) == 2
    said = capsys.readouterr().err.strip().splitlines()
    assert len(said) == 1 and said[0].startswith("posetrack: ")
    assert re.search(line, said[0])
    assert not (tmp_path / "r.mcap").exists()


@pytest.mark.parametrize("options", [("--filter", "pso"), ("--proposal", "paper")])
def test_only_trackers_that_fit_frames_take_keypoints(
    two_hands: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], options: tuple[str, ...]
) -> None:
    keypoints = pixels_file(tmp_path / "k.csv", joints(FARTHER))
    assert track(two_hands, tmp_path / "r.mcap", "--keypoints", keypoints, *options) == 2
    assert "--keypoints cannot be used" in capsys.readouterr().err


def test_keypoints_of_other_frames_are_remarked_on(
    two_hands: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    keypoints = pixels_file(tmp_path / "k.csv", joints(FARTHER))
    text = keypoints.read_text().splitlines()
    keypoints.write_text("\n".join([text[0], *(f"9{row}" for row in text[1:])]) + "\n")
    assert track(two_hands, tmp_path / "r.mcap", "--keypoints", keypoints, "--end", 2) == 0
    assert "k.csv has keypoints for 0 of 2 frames, matched by frame number from 0" in capsys.readouterr().err
