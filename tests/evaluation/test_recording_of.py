"""Which recording a result was made from: where it is looked for, and how it is known."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from posetrack_cli.errors import RecordingError, ResultError, UsageError
from posetrack_cli.evaluation.reading.recording_of import camera_of, required_recording, search_recording
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.hand.run import RunOptions, run_record
from posetrack_cli.recording.camera_file import DEFAULT_CAMERA_NAME
from posetrack_cli.recording.camera_of import Guess
from posetrack_cli.recording.opening import open_recording
from posetrack_cli.recording.pixels import PixelKind
from posetrack_cli.recording.recording import Recording
from posetrack_cli.results import ResultWriter, Subject, read_result
from posetrack_cli.results.reader import Result
from support import images
from support.bags import HEIGHT, WIDTH, write_bag, write_folder
from support.kinect import write_kinect
from support.viewing import make_folder, make_recording, make_result, truth_of, write_camera

RATE = 20.0


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_recording(tmp_path_factory.mktemp("made") / "hand.mcap", 3)


@pytest.fixture
def recording(source: Path, tmp_path: Path) -> Path:
    """A recording in a folder of its own, with a folder beside and one below."""
    home = tmp_path / "home"
    (home / "results").mkdir(parents=True)
    return Path(shutil.copy(source, home / "hand.mcap"))


def result_of(path: Path, recording: Recording) -> Result:
    """A result without estimates: only its run record matters here."""
    camera = recording.cameras[0]
    record = run_record(recording, camera, HandConfig(), RunOptions(path), "none")
    with ResultWriter(path, Subject("hand", camera.name, (), (), ()), camera, record) as writer:
        writer.finish({})
    return read_result(path)


def found_at(result: Result) -> Path:
    found = search_recording(result).recording
    assert found is not None
    return found.path.resolve()


def changed(path: Path) -> None:
    """Another recording of the same size."""
    data = path.read_bytes()
    assert data.count(b"anatomy.segments_mm") == 1
    path.write_bytes(data.replace(b"anatomy.segments_mm", b"anatomy.segments_cm"))


@pytest.mark.parametrize("place", ["home", "home/results", "elsewhere"])
def test_it_is_found_beside_the_result_above_it_and_in_the_working_folder(
    recording: Path, tmp_path: Path, place: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(recording.parent if place == "elsewhere" else tmp_path)
    result = result_of(tmp_path / place / "r.mcap", open_recording(recording))
    assert found_at(result) == recording.resolve()


def test_where_it_is_nowhere_the_reason_says_where_it_was_looked_for(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    result = result_of(tmp_path / "home" / "results" / "r.mcap", open_recording(recording))
    recording.rename(recording.with_name("other.mcap"))
    monkeypatch.chdir(tmp_path)
    search = search_recording(result)
    assert search.recording is None
    looked = f"at {recording}, next to {result.path}, in a parent folder or in the working directory"
    assert search.reason == f"recording 'hand.mcap' not found {looked}; pass it with --recording"
    with pytest.raises(RecordingError, match="not found"):
        required_recording(result)


def test_one_of_the_same_name_and_size_that_differs_is_not_taken(recording: Path, tmp_path: Path) -> None:
    result = result_of(tmp_path / "home" / "results" / "r.mcap", open_recording(recording))
    impostor = Path(shutil.copy(recording, recording.parent / "results" / "hand.mcap"))
    changed(impostor)
    assert found_at(result) == recording.resolve(), "the search goes on"
    recording.unlink()
    reason = search_recording(result).reason
    other, mine = open_recording(impostor).identity()["sha256"], result.run["input.sha256"]
    assert str(impostor) in reason and other[:12] in reason and mine[:12] in reason


def test_a_given_one_that_differs_is_refused_unless_any_will_do(recording: Path, tmp_path: Path) -> None:
    result = result_of(tmp_path / "r.mcap", open_recording(recording))
    changed(recording)
    with pytest.raises(RecordingError, match=r"not the recording .* found SHA-256 .* expected .* hand.mcap"):
        search_recording(result, recording)
    assert search_recording(result, recording, any_recording=True).recording is not None


def test_another_size_is_told_without_reading_it_all(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    result = result_of(tmp_path / "r.mcap", open_recording(recording))
    size = recording.stat().st_size
    with recording.open("ab") as stream:
        stream.write(b"more")
    monkeypatch.setattr("posetrack_cli.recording.identity._feed", pytest.fail)
    with pytest.raises(RecordingError, match=f"found {size + 4} bytes, expected {size} bytes"):
        search_recording(result, recording)


def test_a_changed_one_that_cannot_be_opened_any_more_is_another(recording: Path, tmp_path: Path) -> None:
    result = result_of(tmp_path / "r.mcap", open_recording(recording))
    data = bytearray(recording.read_bytes())
    data[100:] = bytes(len(data) - 100)
    recording.write_bytes(data)
    with pytest.raises(RecordingError, match=r"hand.mcap: not the recording .* found SHA-256"):
        search_recording(result, recording)


def test_a_folder_for_a_file_is_another(recording: Path, tmp_path: Path) -> None:
    result = result_of(tmp_path / "r.mcap", open_recording(recording))
    folder = make_folder(tmp_path / "images", open_recording(recording))  # without stamps
    with pytest.raises(RecordingError, match=r"not the recording .* found a folder, expected a file"):
        search_recording(result, folder)


@pytest.mark.parametrize("below", ["", "day1"], ids=["in a folder", "two deep"])
@pytest.mark.parametrize("typed", ["relative", "absolute"])
def test_a_result_of_its_recording_s_name_in_a_folder_of_results(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, below: str, typed: str
) -> None:
    """``hand run recordings/r.mcap -o results/r.mcap``: found from anywhere, and after both have moved."""
    project = tmp_path / "project"
    for name in ("recordings", "results"):
        (project / name / below).mkdir(parents=True)
    monkeypatch.chdir(project)
    place = Path("recordings", below, "r.mcap")
    place.write_bytes(recording.read_bytes())
    result = result_of(
        Path("results", below, "r.mcap"), open_recording(place.absolute() if typed == "absolute" else place)
    )
    assert found_at(result) == project / place
    monkeypatch.chdir(tmp_path)
    assert found_at(read_result(project / result.path)) == project / place
    moved = project.rename(tmp_path / "moved")
    assert found_at(read_result(Path("moved") / result.path)) == moved / place
    (moved / place).unlink()
    reason = search_recording(read_result(moved / result.path)).reason
    assert reason.startswith("recording 'r.mcap' not found at ") and "not the recording" not in reason


def test_a_result_that_has_moved_alone_finds_its_recording_at_its_path(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "far").mkdir()
    result = result_of(tmp_path / "home" / "results" / "r.mcap", open_recording(recording))
    monkeypatch.chdir(tmp_path)
    moved = result.path.rename(tmp_path / "far" / "r.mcap")
    assert found_at(read_result(moved)) == recording


def test_a_path_leads_nowhere_without_a_digest(recording: Path, tmp_path: Path) -> None:
    """A stranger's result must not have files of its reader's opened and drawn."""
    result = result_of(tmp_path / "r.mcap", open_recording(recording))
    bare = {key: value for key, value in result.run.items() if key not in ("input.sha256", "input.bytes")}
    assert "does not state its recording" in search_recording(replace(result, run=bare)).reason


@pytest.mark.parametrize(
    "stated", ["x/" * 100_000 + "r", "n" * 5000, "a\0b", "/", "..", "/dev/zero", "/proc/self/mem"]
)
def test_no_stated_path_does_harm(recording: Path, tmp_path: Path, stated: str) -> None:
    result = result_of(tmp_path / "r.mcap", open_recording(recording))
    assert search_recording(replace(result, run={**result.run, "input.path": stated})).recording is None


def test_a_result_that_names_no_input_says_so(recording: Path, tmp_path: Path) -> None:
    result = result_of(tmp_path / "r.mcap", open_recording(recording))
    bare = replace(result, run={})
    assert search_recording(bare).reason.endswith("does not state its recording")
    assert search_recording(bare, recording).recording is not None, (
        "what cannot be checked is taken when it is given"
    )


def test_a_folder_is_opened_as_the_run_opened_it(source: Path, tmp_path: Path) -> None:
    folder = make_folder(tmp_path / "images", open_recording(source), mirror=True)
    opened = open_recording(folder, fps=RATE, mirror=True)
    result = result_of(tmp_path / "r.mcap", opened)
    found = search_recording(result).recording
    assert found is not None
    same = zip(found.frames(), opened.frames(), open_recording(source).frames(), strict=True)
    for mine, theirs, unmirrored in same:
        assert mine.stamp_ns == theirs.stamp_ns
        assert (mine.depth == theirs.depth).all() and (mine.depth == unmirrored.depth).all()


def test_another_rate_than_the_run_s_is_refused(source: Path, tmp_path: Path) -> None:
    folder = make_folder(tmp_path / "images", open_recording(source))
    result = result_of(tmp_path / "r.mcap", open_recording(folder, fps=RATE))
    assert search_recording(result, fps=RATE).recording is not None
    with pytest.raises(UsageError, match=r"--fps differs from the run, found 30, expected 20"):
        search_recording(result, fps=30.0)


@pytest.mark.parametrize("mirror", [False, True])
def test_images_mirrored_otherwise_than_the_run_s_are_refused(
    source: Path, tmp_path: Path, mirror: bool
) -> None:
    folder = make_folder(tmp_path / "images", open_recording(source))
    result = result_of(tmp_path / "r.mcap", open_recording(folder, fps=RATE, mirror=mirror))
    assert search_recording(result, mirror=mirror).recording is not None
    with pytest.raises(UsageError, match="--mirror differs from the run, found "):
        search_recording(result, mirror=not mirror)


def test_a_folder_tracked_with_a_camera_file_gets_it_from_the_result(source: Path, tmp_path: Path) -> None:
    """Wherever the file is now; another one makes another recording."""
    recording = open_recording(source)
    folder = make_folder(tmp_path / "images", recording, camera=False)
    camera = write_camera(tmp_path / "camera.toml", recording.cameras[0])
    result = result_of(tmp_path / "r.mcap", open_recording(folder, fps=RATE, camera_file=camera))
    assert search_recording(result, camera_file=camera).recording is not None
    camera.unlink()
    found = search_recording(result).recording
    assert found is not None, search_recording(result).reason
    assert found.cameras == recording.cameras
    other = write_camera(tmp_path / "camera.toml", Camera(512, 424, 400.0, 401.0, 250.0, 210.0))
    with pytest.raises(RecordingError, match="not the recording of the result"):
        search_recording(result, folder, camera_file=other)


@pytest.mark.parametrize("mirror", [False, True])
def test_an_mcap_tracked_with_a_camera_file_gets_the_run_s_camera(
    recording: Path, tmp_path: Path, mirror: bool
) -> None:
    file = write_camera(tmp_path / "mine.toml", Camera(512, 424, 400.0, 401.0, 250.0, 210.0))
    opened = open_recording(recording, camera_file=file, mirror=mirror)
    result = result_of(tmp_path / "home" / "r.mcap", opened)
    file.unlink()
    found = search_recording(result).recording
    assert found is not None
    values = found.cameras[0].values(), opened.cameras[0].values()
    assert {k: v for k, v in values[0].items() if k != "name"} == {
        k: v for k, v in values[1].items() if k != "name"
    }
    assert (next(found.frames()).depth == next(opened.frames()).depth).all()


def test_a_video_tracked_with_a_camera_file_gets_it_from_the_result(tmp_path: Path) -> None:
    """Wherever file and video are now, and with the part of the images that the file has cut out."""
    video = tmp_path / "face.avi"
    writer = cv2.VideoWriter(str(video), cv2.VideoWriter.fourcc(*"MJPG"), RATE, (64, 48))
    for image in images.grey_images(3):
        writer.write(cv2.cvtColor(cv2.resize(image, (64, 48)), cv2.COLOR_GRAY2BGR))
    writer.release()
    file = tmp_path / "mine.toml"
    file.write_text("fx = 80.0\nfy = 81.0\ncx = 30.0\ncy = 20.0\ncrop = [8, 4, 40, 40]\n")
    opened = open_recording(video, "grey", camera_file=file)
    result = result_of(tmp_path / "r.mcap", opened)
    file.unlink()
    moved = Path(shutil.move(video, tmp_path / "renamed.avi"))
    for any_recording in (False, True):
        found = search_recording(result, moved, any_recording=any_recording).recording
        assert found is not None and found.cameras == opened.cameras
        (first,) = next(found.frames()).images
        assert first is not None and first.shape == (40, 40)


SMALL = {"width": WIDTH, "height": HEIGHT, "fx": 70.0, "fy": 71.0, "cx": 31.0, "cy": 23.0}
OF_KINECT = {"width": 320, "height": 288, "fx": 250.0, "fy": 251.0, "cx": 160.0, "cy": 144.0}
EVERY_KIND: dict[str, tuple[PixelKind, Callable[[Path], Path], dict[str, float]]] = {
    "ROS 1, depth": ("depth", lambda folder: write_bag(folder / "r.bag"), SMALL),
    "ROS 1, colour": ("grey", lambda folder: write_bag(folder / "r.bag"), SMALL),
    "ROS 2, folder": ("depth", lambda folder: write_folder(folder / "r", "sqlite3"), SMALL),
    "ROS 2, MCAP": ("grey", lambda folder: write_folder(folder / "r", "mcap"), SMALL),
    "Azure Kinect": ("depth", lambda folder: write_kinect(folder / "r.mkv"), OF_KINECT),
}


@pytest.mark.parametrize("kind", EVERY_KIND)
@pytest.mark.parametrize("told", [False, True], ids=["own camera", "camera file"])
def test_every_kind_is_opened_again_wherever_it_is_now(tmp_path: Path, kind: str, told: bool) -> None:
    """Folders, MCAP files and videos have tests of their own, above."""
    pixels, write, camera = EVERY_KIND[kind]
    path, file = write(tmp_path), tmp_path / "mine.toml"
    table = "[cameras.color_frame]\n" if pixels == "grey" else ""
    file.write_text(table + "".join(f"{key} = {value}\n" for key, value in camera.items()))
    given = {"camera_file": file} if told else {}
    opened = open_recording(path, pixels, **given)
    assert (opened.cameras[0].fx == camera["fx"]) or not told
    stamps = [frame.stamp_ns for frame in opened.frames()]
    result = result_of(tmp_path / "r.mcap", opened)
    file.unlink()
    moved = path.rename(tmp_path / f"other{path.suffix}")
    found = search_recording(result, moved).recording
    assert found is not None and found.cameras == opened.cameras
    assert [frame.stamp_ns for frame in found.frames()] == stamps and stamps


@pytest.mark.parametrize("mirror", [False, True])
def test_another_recording_without_a_camera_gets_that_of_the_run(
    source: Path, tmp_path: Path, mirror: bool
) -> None:
    """Also where the run had it from its recording's messages."""
    opened = open_recording(source, mirror=mirror)
    result = result_of(tmp_path / "r.mcap", opened)
    folder = make_folder(tmp_path / "images", open_recording(source), camera=False)
    found = search_recording(result, folder, any_recording=True, fps=RATE).recording
    assert found is not None
    assert found.cameras == (replace(opened.cameras[0], name=DEFAULT_CAMERA_NAME),)
    assert (next(found.frames()).depth == next(opened.frames()).depth).all()


def test_another_recording_of_another_size_is_told_without_a_file_that_nobody_knows(
    source: Path, tmp_path: Path
) -> None:
    result = result_of(tmp_path / "r.mcap", open_recording(source))
    small = tmp_path / "small"
    small.mkdir()
    cv2.imwrite(str(small / "0.png"), np.full((48, 64), 700, np.uint16))
    with pytest.raises(RecordingError, match=r"small, with the run's camera: .* found images of 64x48"):
        search_recording(result, small, any_recording=True, fps=RATE)


def test_a_folder_of_one_camera_without_a_name_is_opened_as_the_run_opened_it(tmp_path: Path) -> None:
    """The run record calls the camera what its frames do, which no file and no folder does."""
    folder = images.write_rig(tmp_path / "rig", {"left": images.grey_images(2)}) / "left"
    unnamed = Path(shutil.copytree(folder, tmp_path / "unnamed"))
    result = result_of(tmp_path / "r.mcap", open_recording(unnamed, "grey", fps=RATE, guess=Guess()))
    assert result.run["input.cameras"] == DEFAULT_CAMERA_NAME
    record = {**result.run, "intrinsics": "guessed"}
    found = search_recording(replace(result, run=record), unnamed).recording
    assert found is not None and found.is_guessed


def test_options_that_do_not_apply_are_wrong_usage(recording: Path, tmp_path: Path) -> None:
    result = result_of(tmp_path / "home" / "r.mcap", open_recording(recording))
    with pytest.raises(UsageError, match="--fps does not apply to an MCAP file"):
        search_recording(result, fps=7.0)


def test_the_camera_of_a_run(recording: Path, tmp_path: Path) -> None:
    opened = open_recording(recording)
    result = result_of(tmp_path / "r.mcap", opened)
    assert camera_of(result.run) == opened.cameras[0]
    for record in ({}, {"camera": "nonsense"}, {"camera": '{"width": 3}'}):
        with pytest.raises(ResultError, match="run record has no valid camera"):
            camera_of(record)


def test_support_makes_results_of_every_frame(source: Path, tmp_path: Path) -> None:
    """The results that other tests rest on hold the truth of every frame."""
    recording = open_recording(source)
    result = read_result(make_result(tmp_path / "r.mcap", recording))
    stamps = [frame.stamp_ns for frame in recording.frames()]
    assert result.columns()["stamp_ns"].tolist() == stamps == [t.stamp_ns for t in truth_of(recording)]
