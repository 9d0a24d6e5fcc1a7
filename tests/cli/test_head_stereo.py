"""``posetrack head stereo``: what it refuses, and what it writes of a recording that is measured with."""

from __future__ import annotations

import filecmp
import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from posetrack_cli.cli.main import run
from posetrack_cli.errors import EXIT_DATA_LOST
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.head.config import HeadStereoConfig
from posetrack_cli.head.dense.numbers import FACE_NUMBERS
from posetrack_cli.head.face.points import POINT_NAMES
from posetrack_cli.head.run import HeadRun, HeadRunOptions
from posetrack_cli.head.subject import head_subject, with_dense_face
from posetrack_cli.head.tracker.stereo import components_of, make_stereo_tracker
from posetrack_cli.recording.camera_file import camera_file_text
from posetrack_cli.recording.opening import open_recording
from posetrack_cli.results import load_arrays, read_result
from posetrack_cli.tracking.options import RunOutcome
from support.results import all_messages

ASIDE = ((1.0, 0.0, 0.0, -120.0), (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0))
CAMERAS = (
    Camera(160, 120, 250.0, 250.0, 79.5, 59.5, name="left"),
    Camera(160, 120, 250.0, 250.0, 79.5, 59.5, name="right", camera_T_reference=ASIDE),
)


def write_recording(folder: Path, cameras: tuple[Camera, ...] = CAMERAS, frames: int = 3) -> Path:
    """Folders of noise in which no face is."""
    rng = np.random.default_rng(0)
    for camera in cameras:
        (folder / camera.name).mkdir(parents=True)
        for index in range(frames):
            image = rng.integers(90, 110, (camera.height, camera.width), dtype=np.uint8)
            cv2.imwrite(str(folder / camera.name / f"{index:06d}.png"), image)
    (folder / "camera.toml").write_text(camera_file_text(cameras))
    return folder


def line(capsys: pytest.CaptureFixture[str]) -> str:
    """The one line on standard error."""
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1, lines
    return lines[0]


@pytest.mark.parametrize("passes", ["1", "2"])
def test_no_face_is_one_line_with_frames_and_score(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], passes: str
) -> None:
    recording = write_recording(tmp_path / "noise")
    output = tmp_path / "r.mcap"
    code = run(["head", "stereo", str(recording), "-o", str(output), "--fps", "30", "--passes", passes])
    assert code == EXIT_DATA_LOST
    told = line(capsys)
    assert "no face found, found 3 frames searched, best score 0.00" in told
    assert "kept" not in told
    assert [path.name for path in tmp_path.iterdir()] == ["noise"]


@pytest.mark.parametrize(
    ("arguments", "code", "expected"),
    [
        (["--detector", "yunet"], 2, "--detector-model"),
        (["--set", "model.component=3"], 2, "components"),
        (["--cameras", "left"], 2, "too few cameras"),
        (["--cameras", "left,rihgt"], 1, "right"),
        (["--start", "9"], 2, "no frames to track, found 3 frames"),
        (["--load-model", "nowhere.npz"], 2, "no such model file"),
        (["--init", "nowhere.csv"], 2, "nowhere.csv: cannot be read"),
        (["--resume"], 1, "no unfinished result to resume"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_what_cannot_be_meant_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], code: int, expected: str
) -> None:
    recording = write_recording(tmp_path / "noise")
    asked = ["head", "stereo", str(recording), "-o", str(tmp_path / "r.mcap"), "--fps", "30", *arguments]
    assert run(asked) == code
    assert expected in line(capsys)
    assert [path.name for path in tmp_path.iterdir()] == ["noise"]


def test_one_camera_is_refused_with_what_is_needed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording = write_recording(tmp_path / "one", CAMERAS[:1])
    assert run(["head", "stereo", str(recording), "-o", str(tmp_path / "r.mcap"), "--fps", "30"]) == 2
    assert "too few cameras" in (told := line(capsys))
    assert "left/ and right/" in told


# On a made recording


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A synthetic head that hardly moves, with its truth."""
    path = tmp_path_factory.mktemp("made") / "head.mcap"
    assert run(["head", "synth", "-o", str(path), "--frames", "10", "--seed", "3"]) == 0
    return path


@pytest.fixture(scope="module")
def tracked(made: Path) -> Path:
    path = made.with_name("tracked.mcap")
    assert stereo(made, path, "--save-model", made.with_name("face.npz")) == 0
    return path


def test_a_person_whom_two_cameras_measured_is_held_with_one(
    made: Path, tracked: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """In true size, though the tracker of one camera would take the likeliest."""
    output, few = made.with_name("person.mcap"), ("--particles", "100", "--passes", "1", "--end", "4")
    asked = ["head", "mono", str(made), "--cameras", "left", *few, "--person", str(tracked)]
    assert run([*asked, "-o", str(output)]) == 0
    mine, theirs = load_arrays(output), load_arrays(tracked)
    np.testing.assert_allclose(mine["position"], theirs["position"][:4], atol=4.0)  # of 700: half a per cent
    assert not np.any(mine["status"] == "lost")
    record = read_result(output).run
    assert (record["scale"], record["person"]) == ("person", tracked.name) and record["person.sha256"]
    numbers = read_result(output).numbers()
    names = ("size", "size_sd", "adjusted_frames")
    np.testing.assert_allclose([numbers[name][-1] for name in names][:2], [1.0, 0.005])
    capsys.readouterr()
    assert run([*asked, "-o", str(output), "--overwrite", "--interpupillary-mm", "63"]) == 2
    assert "--person and --interpupillary-mm both set the size of the head" in line(capsys)


def stereo(recording: Path, output: Path, *arguments: object) -> int:
    asked = ["head", "stereo", str(recording), "-o", str(output), "--particles", "100"]
    return run([*asked, *map(str, arguments)])


def table(path: Path, truth: tuple[str, ...] = ()) -> dict[str, float]:
    """Means of a result's figures after one rigid offset."""
    report = path.with_suffix(".json")
    asked = ["eval", str(path), *truth, "--align", "rigid", "--json", str(report), "--overwrite"]
    assert run(asked) == 0
    (found,) = json.loads(report.read_text())["results"]
    values = found["metrics"].items()
    return {name: value["value"] if "value" in value else value["mean"] for name, value in values}


def test_a_made_head_is_tracked_and_measured_against_its_own_truth(tracked: Path) -> None:
    found = table(tracked)
    assert (found["frames"], found["lost"], found["matched"]) == (10, 0, 10)
    assert found["position_mm"] < 1.0 and found["rotation_deg"] < 1.0
    assert found["particles"] == 100
    result = read_result(tracked)
    assert result.finished
    assert [camera.name for camera in result.cameras()] == ["left", "right"]
    assert result.truth_topics


def test_a_converted_recording_gives_the_same_messages(made: Path, tracked: Path, tmp_path: Path) -> None:
    assert run(["convert", str(made), "-o", str(tmp_path / "c.mcap")]) == 0
    assert stereo(tmp_path / "c.mcap", tmp_path / "r.mcap") == 0
    assert all_messages(tmp_path / "r.mcap") == all_messages(tracked)


def test_a_page_shows_the_worst_frames(
    made: Path, tracked: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page = tmp_path / "page.html"
    assert run(["eval", str(tracked), "--recording", str(made), "--html", str(page)]) == 0
    assert not capsys.readouterr().err
    assert page.read_text().count("data:image/png;base64,") >= 1


def test_the_same_options_give_the_same_bytes_and_others_do_not(made: Path, tracked: Path) -> None:
    again, other = made.with_name("again.mcap"), made.with_name("other.mcap")
    assert stereo(made, again) == stereo(made, other, "--seed", "1") == 0
    assert filecmp.cmp(tracked, again, shallow=False)
    assert not filecmp.cmp(tracked, other, shallow=False)


def test_a_second_pass_equals_a_run_with_the_saved_model(made: Path, tracked: Path) -> None:
    twice, loaded = made.with_name("twice.mcap"), made.with_name("loaded.mcap")
    assert stereo(made, twice, "--passes", "2") == 0
    assert stereo(made, loaded, "--load-model", made.with_name("face.npz")) == 0
    mine, theirs, once = (load_arrays(path) for path in (twice, loaded, tracked))
    # what is usual for the face is learned from fewer frames in the first of two passes
    for one in (mine, theirs):
        one["numbers"] = one["numbers"][:, : -len(FACE_NUMBERS)]
    for name in mine:
        np.testing.assert_array_equal(mine[name], theirs[name], err_msg=name)
    assert np.any(mine["position"] != once["position"])
    assert read_result(twice).run["passes"] == "2"


@pytest.mark.parametrize(("passes", "frames"), [(1, 5), (2, 14)])
def test_the_tracker_goes_on_from_its_checkpoint_to_the_same_bytes(
    made: Path, tmp_path: Path, passes: int, frames: int
) -> None:
    few = {"particles": {"count": 50}, "output": {"flush_frames": 3}, "run": {"passes": passes}}
    config = HeadStereoConfig.model_validate(few)
    source = open_recording(made, "grey")

    def track(name: str, stop_after: int = 0, *, resume: bool = False) -> RunOutcome:
        asked = iter(range(1, 1000))
        return HeadRun(
            source,
            config,
            HeadRunOptions(tmp_path / name, resume=resume, smooth=True),
            name="head-stereo",
            subject=with_dense_face(head_subject(source.cameras[0].name, components_of(config))),
            flush_frames=config.output.flush_frames,
            make_tracker=lambda known: make_stereo_tracker(config, source.cameras, known),
        ).track(lambda estimate: None, lambda: next(asked) == stop_after)

    track("whole.mcap")
    assert track("cut.mcap", frames).stopped
    assert track("cut.mcap", resume=True).tracked < 10 * passes
    assert filecmp.cmp(tmp_path / "whole.mcap", tmp_path / "cut.mcap", shallow=False)


def test_a_smoothed_track_stands_beside_the_filtered_one(
    made: Path, tracked: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "r.mcap"
    assert stereo(made, path, "--smooth") == 0
    assert [one.name for one in tmp_path.iterdir()] == ["r.mcap"]
    mine, theirs = load_arrays(path), load_arrays(tracked)
    for name in mine:
        np.testing.assert_array_equal(mine[name], theirs[name], err_msg=name)
    report = tmp_path / "both.json"
    asked = ["eval", str(path), "--track", "both", "--align", "rigid", "--json", str(report)]
    assert run(asked) == 0
    found = [one["metrics"] for one in json.loads(report.read_text())["results"]]
    assert [one["frames"]["value"] for one in found] == [10, 10]
    assert found[1]["position_mm"]["mean"] < 1.0 and found[1]["rotation_deg"]["mean"] < 1.0
    assert found[1]["jitter_mm"]["mean"] < 0.7 * found[0]["jitter_mm"]["mean"]
    drawn = ["--track", "both", "--select", "0:2", "-o", f"{path}.png"]  # a sheet of all takes seconds
    assert run(["view", str(path), "--recording", str(made), *drawn]) == 0
    capsys.readouterr()
    assert run(["export", str(path), "--track", "smoothed"]) == 0
    rows = [row for row in capsys.readouterr().out.splitlines() if not row.startswith("#")]
    assert len(rows) == 11


def test_clicked_points_begin_a_run(
    made: Path, tracked: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    left, first = read_result(tracked).camera(), load_arrays(tracked)["points"][0]
    pixels = left.pixels_from_points(first)[0].round().tolist()
    rows = [f"left,{name},{x},{y}" for name, (x, y) in zip(POINT_NAMES, pixels, strict=True)]
    (tmp_path / "clicked.csv").write_text("\n".join(["camera,point,x,y", *rows]))
    assert stereo(made, tmp_path / "r.mcap", "--init", tmp_path / "clicked.csv") == 0
    run_record = read_result(tmp_path / "r.mcap").run
    assert run_record["init"] == "clicked.csv" and len(run_record["init.sha256"]) == 64
    assert table(tmp_path / "r.mcap")["position_mm"] < 1.0
    (tmp_path / "mirrored.csv").write_text("\n".join(["camera,point,x,y", *(_swapped(row) for row in rows)]))
    capsys.readouterr()
    assert stereo(made, tmp_path / "m.mcap", "--init", tmp_path / "mirrored.csv") == 1
    assert "clicked points do not form a head" in line(capsys)
    assert not list(tmp_path.glob("m.mcap*"))


def test_landmarks_from_elsewhere_begin_a_run(made: Path, tracked: Path, tmp_path: Path) -> None:
    left, points = read_result(tracked).camera(), load_arrays(tracked)["points"]
    rows = [
        f"{t},{name},{x:.1f},{y:.1f}"
        for t, frame in enumerate(points)
        for name, (x, y) in zip(POINT_NAMES, left.pixels_from_points(frame)[0], strict=True)
    ]
    (tmp_path / "told.csv").write_text("\n".join(["frame,point,x,y", *rows]))
    assert stereo(made, tmp_path / "r.mcap", "--landmarks", tmp_path / "told.csv") == 0
    assert read_result(tmp_path / "r.mcap").run["landmarks"] == "told.csv"
    assert np.any(load_arrays(tmp_path / "r.mcap")["position"] != load_arrays(tracked)["position"])
    assert table(tmp_path / "r.mcap")["position_mm"] < 1.0


def _swapped(row: str) -> str:
    """A row with the subject's left and right confused."""
    camera, point, x, y = row.split(",")
    side, _, what = point.partition("_")
    return f"{camera},{'left' if side == 'right' else 'right'}_{what},{x},{y}"


@pytest.mark.parametrize("person", ["person-a", "person-b"])
def test_the_rendered_heads_with_their_truth(measured_data: Path, tmp_path: Path, person: str) -> None:
    folder = measured_data / "heads" / person
    rig = write_rig(tmp_path / "camera.toml", json.loads((folder / "calibration.json").read_text()))
    options = ("--camera", rig, "--fps", "30", "--end", "12")
    assert stereo(folder, tmp_path / "r.mcap", *options) == 0
    found = table(tmp_path / "r.mcap", ("--truth", str(folder / "truth.csv")))
    assert (found["matched"], found["unmatched"], found["lost"]) == (12, 0, 0)
    assert found["position_mm"] < 1.0 and found["rotation_deg"] < 1.5


def write_rig(path: Path, calibration: dict[str, Any]) -> Path:
    """A camera file of the two cameras of a calibration.json."""
    cameras = [
        Camera(
            values["width"],
            values["height"],
            values["K"][0][0],
            values["K"][1][1],
            values["K"][0][2],
            values["K"][1][2],
            name=name,
            camera_T_reference=tuple(
                (*row, t) for row, t in zip(values["R_from_left"], values["t_from_left_mm"], strict=True)
            ),
        )
        for name, values in calibration["cameras"].items()
    ]
    path.write_text(camera_file_text(cameras))
    return path
