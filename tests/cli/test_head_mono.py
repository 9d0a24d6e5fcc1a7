"""``posetrack head mono``: what it reads and refuses, what it says of a guess, and what it writes."""

from __future__ import annotations

import filecmp
import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from posetrack_cli.cli.main import run
from posetrack_cli.errors import EXIT_DATA_LOST
from posetrack_cli.evaluation.measuring.evaluate import PRIOR_NOTE
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.head.config import HeadMonoConfig
from posetrack_cli.head.dense.numbers import FACE_NUMBERS
from posetrack_cli.head.face.points import POINT_NAMES
from posetrack_cli.head.model_file import model_bytes
from posetrack_cli.head.multilinear.face_model import load_face_model
from posetrack_cli.head.run import HeadRun, HeadRunOptions
from posetrack_cli.head.subject import mono_subject, with_dense_face
from posetrack_cli.head.tracker.mono import make_mono_tracker
from posetrack_cli.outputs import part_path
from posetrack_cli.recording.camera_file import camera_file_text
from posetrack_cli.recording.opening import open_recording
from posetrack_cli.results import load_arrays, read_result
from posetrack_cli.tracking.options import RunOutcome
from support.mono_scene import map_skin_soon
from support.results import all_messages

FRAMES = 12
SEED = ("--frames", str(FRAMES), "--seed", "3", "--camera-count", "1")
CAMERA = Camera(160, 120, 250.0, 250.0, 79.5, 59.5)
ESTIMATED = "no calibration: focal length estimated as "


def mono(recording: Path, output: Path, *arguments: object) -> int:
    asked = ["head", "mono", str(recording), "-o", str(output), "--particles", "100"]
    return run([*asked, *map(str, arguments)])


def lines(capsys: pytest.CaptureFixture[str]) -> list[str]:
    """What was said on standard error."""
    return capsys.readouterr().err.splitlines()


def write_noise(folder: Path, names: tuple[str, ...] = ("",), frames: int = 3) -> Path:
    """Images of noise in which no face is, of one camera or more."""
    rng = np.random.default_rng(0)
    for name in names:
        (folder / name).mkdir(parents=True, exist_ok=True)
        for index in range(frames):
            image = rng.integers(90, 110, (CAMERA.height, CAMERA.width), dtype=np.uint8)
            cv2.imwrite(str(folder / name / f"{index:06d}.png"), image)
    return folder


def write_video(path: Path, images: list[np.ndarray]) -> Path:
    height, width = images[0].shape
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 30.0, (width, height))
    for image in images:
        writer.write(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR))
    writer.release()
    return path


# What is refused


@pytest.mark.parametrize("passes", ["1", "2"])
def test_no_face_is_one_line_with_frames_and_score(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], passes: str
) -> None:
    recording = write_noise(tmp_path / "noise")
    assert mono(recording, tmp_path / "r.mcap", "--fps", "30", "--passes", passes) == EXIT_DATA_LOST
    guessed, told = lines(capsys)
    assert ESTIMATED in guessed
    assert "no face found, found 3 frames searched, best score 0.00" in told
    # noise of 90 to 109: its 5th and 95th percentile, and nothing to be blamed
    assert "3 images checked (8-bit grey): face in 0; brightness 90 to 109, median 10" in told
    assert "0 % of pixels white; start from clicked points with --init FILE" in told
    assert [path.name for path in tmp_path.iterdir()] == ["noise"]


@pytest.mark.parametrize(
    ("arguments", "code", "expected"),
    [
        (["--detector", "yunet"], 2, "--detector-model"),
        (["--landmarks", "nowhere.csv"], 2, "nowhere.csv: cannot be read"),
        (["--landmarks-unit", "px"], 2, "--landmarks-unit requires --landmarks"),
        (["--set", "adjustment.view=3"], 2, "views"),
        (["--interpupillary-mm", "6.3"], 2, "'person.interpupillary_mm' cannot be used, found 6.3"),
        (["--person", "nowhere.mcap"], 2, "nowhere.mcap: no such model file"),
        (
            ["--person", "p.mcap", "--load-model", "m.npz"],
            2,
            "--person and --load-model are mutually exclusive",
        ),
        (["--face-model", "nowhere.npz"], 2, "no such face model"),
        (["--load-model", "nowhere.npz"], 2, "no such model file"),
        (["--init", "nowhere.csv"], 2, "nowhere.csv: cannot be read"),
        (["--start", "9"], 2, "no frames to track, found 3 frames"),
        (["--fov", "200"], 2, "--fov out of range, found 200, expected degrees from 1 to 170"),
        (["--fov", "60"], 2, "--fov cannot be used with a calibrated camera, found 250 px; leave it out"),
        (["--cameras", "left"], 1, "no camera 'left'"),
        (["--camera", "nowhere.toml"], 1, "nowhere.toml: cannot be read"),
        (["--resume"], 1, "no unfinished result to resume"),
        (
            ["--detector-model", "m.onnx"],
            2,
            "--detector-model does not apply, found detector haar; add --detector",
        ),
        (
            ["--init", "p.csv", "--face", "2"],
            2,
            "--face cannot be combined with --init FILE, found 2; leave it out",
        ),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_what_cannot_be_meant_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], code: int, expected: str
) -> None:
    recording = write_noise(tmp_path / "noise")
    (recording / "camera.toml").write_text("fx = 250.0\nfy = 250.0\ncx = 79.5\ncy = 59.5\n")
    assert mono(recording, tmp_path / "r.mcap", "--fps", "30", *arguments) == code
    (told,) = lines(capsys)
    assert expected in told
    assert [path.name for path in tmp_path.iterdir()] == ["noise"]


def test_a_recording_that_is_not_there(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert mono(tmp_path / "nowhere.mp4", tmp_path / "r.mcap") == 1
    assert lines(capsys) == [f"posetrack: {tmp_path / 'nowhere.mp4'}: no such file or folder"]


@pytest.mark.parametrize("calibrated", [True, False])
def test_several_cameras_are_listed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], calibrated: bool
) -> None:
    recording = write_noise(tmp_path / "two", ("left", "right"))
    if calibrated:
        aside = ((1.0, 0.0, 0.0, -120.0), (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0))
        cameras = [
            Camera(160, 120, 250.0, 250.0, 79.5, 59.5, name=name, camera_T_reference=place)
            for name, place in (("left", Camera.camera_T_reference), ("right", aside))
        ]
        (recording / "camera.toml").write_text(camera_file_text(cameras))
    assert mono(recording, tmp_path / "r.mcap", "--fps", "30") == 2
    (told,) = lines(capsys)
    assert "several cameras, found left, right, expected one; choose one with --cameras" in told
    assert mono(recording, tmp_path / "r.mcap", "--fps", "30", "--cameras", "right") == EXIT_DATA_LOST
    assert "no face found" in lines(capsys)[-1]


def test_a_model_that_stereo_learned_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recording, model = write_noise(tmp_path / "noise"), tmp_path / "stereo.npz"
    model.write_bytes(model_bytes({}, [CAMERA], "head-stereo"))
    assert mono(recording, tmp_path / "r.mcap", "--fps", "30", "--load-model", model) == 2
    expected = "model belongs to another tracker, found head-stereo, expected head-mono"
    assert expected in lines(capsys)[-1]
    assert not list(tmp_path.glob("r.mcap*"))


@pytest.mark.parametrize("option", ["--load-model", "--face-model"])
def test_a_text_that_is_no_model_is_told_in_our_words(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], option: str
) -> None:
    """Of a guess that no frame was tracked by nothing is said."""
    recording, text = write_noise(tmp_path / "noise"), tmp_path / "text.npz"
    text.write_text("no arrays")
    assert mono(recording, tmp_path / "r.mcap", "--fps", "30", option, text) == 1
    (told,) = lines(capsys)
    assert "found not a complete npz file" in told


@pytest.mark.parametrize(
    "header",
    [
        ["a list"],
        "text",
        {},
        {"format": "posetrack.head_model", "version": 1, "points": list(POINT_NAMES)},
        {"format": "posetrack.head_model", "version": 1, "points": 3, "tracker": "head-mono", "cameras": []},
        {"format": "posetrack.head_model", "version": 1, "points": list(POINT_NAMES), "tracker": 3},
        {
            "format": "posetrack.head_model",
            "version": 1,
            "points": list(POINT_NAMES),
            "tracker": "head-mono",
            "cameras": 1,
        },
    ],
    ids=range(7),
)
def test_a_model_with_another_header_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], header: object
) -> None:
    recording, model = write_noise(tmp_path / "noise"), tmp_path / "face.npz"
    np.savez(model, header=np.array(json.dumps(header)))
    assert mono(recording, tmp_path / "r.mcap", "--fps", "30", "--load-model", model) == 1
    (told,) = lines(capsys)
    assert told.startswith(f"posetrack: {model}: not a head model, found ")


def test_a_video_that_cannot_be_opened(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "face.mp4"
    path.write_bytes(b"\0\0\0\x18ftypisom no more")
    assert mono(path, tmp_path / "r.mcap") == 1
    told = "not a readable video, found an MP4 file without its index (interrupted recording)"
    assert lines(capsys) == [f"posetrack: {path}: {told}"]


# On a made recording


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A synthetic head, with its truth."""
    path = tmp_path_factory.mktemp("made") / "head.mcap"
    assert run(["head", "synth", "-o", str(path), *SEED]) == 0
    return path


@pytest.fixture(scope="module")
def images(made: Path) -> list[np.ndarray]:
    return [frame.images[0] for frame in open_recording(made, "grey").frames()]


@pytest.fixture(scope="module")
def video(made: Path, images: list[np.ndarray]) -> Path:
    """The same as a video of which nothing tells the focal length."""
    return write_video(made.with_name("head.avi"), images)


@pytest.fixture(scope="module")
def tracked(made: Path) -> Path:
    path = made.with_name("tracked.mcap")
    assert mono(made, path, "--passes", "1", "--save-model", made.with_name("face.npz")) == 0
    return path


def table(path: Path) -> dict[str, float]:
    """Means of a result's figures after one rigid offset."""
    report = path.with_suffix(".json")
    assert run(["eval", str(path), "--align", "rigid", "--json", str(report), "--overwrite"]) == 0
    (found,) = json.loads(report.read_text())["results"]
    values = found["metrics"].items()
    return {name: value["value"] if "value" in value else value["mean"] for name, value in values}


def test_a_made_head_is_tracked_and_measured_against_its_own_truth(tracked: Path) -> None:
    found = table(tracked)
    assert (found["frames"], found["lost"], found["matched"]) == (FRAMES, 0, FRAMES)
    assert found["position_mm"] < 8.0 and found["rotation_deg"] < 2.5  # a few frames see little of a face
    result = read_result(tracked)
    assert result.finished
    assert result.truth_topics
    assert {"identity_1", "identity_spread_1"} < set(result.numbers())
    assert [channel.topic for _, channel in result.channels][:2] == [
        "/camera/annotations",
        "/camera/calibration",
    ]


def test_the_record_says_what_one_camera_cannot_know(
    tracked: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    stated = {"tracker": "head-mono", "scale": "prior", "intrinsics": "given", "face": "1"}
    record = read_result(tracked).run
    assert {key: record[key] for key in stated} == stated
    assert record["face_model"] == "shipped"
    assert run(["eval", str(tracked)]) == 0
    assert PRIOR_NOTE in capsys.readouterr().out


def test_a_folder_with_its_camera_file_is_as_good(made: Path, tracked: Path, tmp_path: Path) -> None:
    """The first frames; and equal images and seeds give equal estimates."""
    recording, folder = open_recording(made, "grey"), tmp_path / "folder"
    frames = list(recording.frames())[: FRAMES // 2]
    folder.mkdir()
    for frame in frames:
        assert cv2.imwrite(str(folder / f"{frame.index:06d}.png"), frame.images[0])
    rows = [f"{frame.index:06d}.png,{frame.stamp_ns}" for frame in frames]
    (folder / "timestamps.csv").write_text("\n".join(["filename,stamp_ns", *rows]))
    (folder / "camera.toml").write_text(camera_file_text(recording.cameras))
    assert mono(folder, tmp_path / "r.mcap", "--passes", "1") == 0
    mine, theirs = load_arrays(tmp_path / "r.mcap"), load_arrays(tracked)
    for name in mine:
        # But for the last one, whose velocity does not know the next frame.
        np.testing.assert_array_equal(mine[name][:-1], theirs[name][: len(frames) - 1], err_msg=name)
    assert run(["convert", str(folder), "-o", str(tmp_path / "c.mcap")]) == 0
    assert mono(tmp_path / "c.mcap", tmp_path / "rc.mcap", "--passes", "1") == 0
    assert all_messages(tmp_path / "rc.mcap") == all_messages(tmp_path / "r.mcap")


def test_a_video_without_calibration_is_tracked_with_an_estimated_focal_length(
    video: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert mono(video, tmp_path / "r.mcap", "--passes", "1", "--end", "6") == 0
    result = read_result(tmp_path / "r.mcap")
    focal, sd = (float(result.run[key]) for key in ("focal_px", "focal_sd_px"))
    assert lines(capsys)[0].startswith(f"{video}: {ESTIMATED}{focal:.0f} +- {sd:.0f} px (field of view ")
    assert (result.run["intrinsics"], result.camera().fx) == ("estimated", focal)
    assert json.loads(result.run["camera"])["cx"] == result.camera().cx
    # the head is 700 mm away from a camera of 1000 px; six frames hardly show the focal length
    assert abs(np.log(focal / 1000.0)) < 2.0 * sd / focal
    status = load_arrays(result.path)["status"]
    assert len(status) == 6 and not np.any(status == "lost")
    drawn = ["--recording", str(video), "--select", "0:2", "-o", str(tmp_path / "sheet.png")]
    assert run(["view", str(result.path), *drawn]) == 0
    assert run(["eval", str(result.path), "--recording", str(video), "--html", str(tmp_path / "r.html")]) == 0
    note = f"the focal length is estimated as {focal} +- {sd} px"
    assert note in (tmp_path / "r.html").read_text()
    assert run(["export", str(result.path), "-o", str(tmp_path / "r.csv")]) == 0
    assert "identity_10" in (tmp_path / "r.csv").read_text()


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda image: image // 16, "images are dark"),
        (lambda image: np.maximum(image, np.uint8(255)), "100 % of pixels white; images are mostly white"),
    ],
    ids=["dark", "white"],
)
def test_images_without_a_face_that_can_be_found(
    images: list[np.ndarray], tmp_path: Path, capsys: pytest.CaptureFixture[str], change, expected: str
) -> None:
    folder = tmp_path / "images"
    folder.mkdir()
    for index, image in enumerate(images[:1]):
        assert cv2.imwrite(str(folder / f"{index}.png"), np.ascontiguousarray(change(image)))
    assert mono(folder, tmp_path / "r.mcap", "--fps", "30", "--passes", "1") == EXIT_DATA_LOST
    assert expected in lines(capsys)[-1]


def test_a_turned_image_is_tracked(images: list[np.ndarray], tmp_path: Path) -> None:
    """A quarter turn of the image, clockwise, is a roll of the head."""
    for name, turns in (("upright", 0), ("turned", 3)):
        (tmp_path / name).mkdir()
        turned = np.ascontiguousarray(np.rot90(images[0], turns))
        assert cv2.imwrite(str(tmp_path / name / "0.png"), turned)
        assert mono(tmp_path / name, tmp_path / f"{name}.mcap", "--fps", "30", "--passes", "1") == 0
    upright, turned = (
        Rotation.from_quat(load_arrays(tmp_path / f"{name}.mcap")["quaternion"][0])
        for name in ("upright", "turned")
    )
    roll = (turned * upright.inv()).as_rotvec(degrees=True)
    # two starts from one frame differ by a few degrees of yaw and pitch
    np.testing.assert_allclose(roll, [0.0, 0.0, 90.0], atol=8.0)


def test_a_focal_length_that_is_given_is_taken(made: Path, video: Path, tmp_path: Path) -> None:
    """A field of view of the made camera's 1000 px gives its distances, and so does a camera file."""
    fov = 2 * np.degrees(np.arctan(320 / 1000))
    assert mono(video, tmp_path / "fov.mcap", "--passes", "1", "--end", "3", "--fov", fov) == 0
    (tmp_path / "mine.toml").write_text("fx = 1000.0\nfy = 1000.0\ncx = 319.5\ncy = 239.5\n")
    mine = ("--camera", tmp_path / "mine.toml", "--end", "3")
    assert mono(video, tmp_path / "toml.mcap", "--passes", "1", *mine) == 0
    results = [read_result(tmp_path / name) for name in ("fov.mcap", "toml.mcap")]
    assert [result.run["intrinsics"] for result in results] == ["guessed", "given"]
    assert [result.camera().fx for result in results] == pytest.approx([1000.0, 1000.0])


def test_another_seed_gives_other_estimates(made: Path, tracked: Path) -> None:
    """That the same one gives the same, runs from a folder and resumed runs show."""
    other = made.with_name("other.mcap")
    assert mono(made, other, "--passes", "1", "--seed", "1", "--end", "6") == 0
    one, seeded = (load_arrays(path)["position"][:6] for path in (tracked, other))
    assert not np.array_equal(one, seeded)


@pytest.mark.parametrize("passes", [(), ("--passes", "2"), ("--set", "run.passes=2")])
def test_as_printed_there_is_one_pass_unless_another_is_asked_for(
    made: Path, tmp_path: Path, passes: tuple[str, ...]
) -> None:
    few = ("--config", "head-mono-paper", "--particles", "50", "--end", "7")
    assert mono(made, tmp_path / "r.mcap", *few, *passes) == 0
    result = read_result(tmp_path / "r.mcap")
    count = 2 if passes else 1
    assert (result.run["passes"], result.summary["passes"]) == (str(count), str(count))
    assert json.loads(result.run["configuration"])["run"] == {"passes": count}
    listed = json.loads(result.run["deviations_from_print"])
    assert listed[0] == "4.5: particles.count is 50, not 750"
    assert ("3.4, 4.5: run.passes is 2, not 1" in listed) == (count == 2)
    assert "4.2: the shipped face model was built from ICT-FaceKit" in listed


def test_two_passes_are_the_default_and_equal_a_run_with_the_saved_model(made: Path, tracked: Path) -> None:
    """But for the skin, which tells in these images alone."""
    twice, loaded = made.with_name("twice.mcap"), made.with_name("loaded.mcap")
    assert mono(made, twice, "--set", "skin.use=false") == 0
    assert mono(made, loaded, "--passes", "1", "--load-model", made.with_name("face.npz")) == 0
    mine, theirs, once = (load_arrays(path) for path in (twice, loaded, tracked))
    # what is usual for the face is learned from fewer frames in the first of two passes
    for one in (mine, theirs):
        one["numbers"] = one["numbers"][:, : -len(FACE_NUMBERS)]
    for name in mine:
        np.testing.assert_array_equal(mine[name], theirs[name], err_msg=name)
    assert np.any(mine["position"] != once["position"])
    assert read_result(twice).run["passes"] == "2"
    shutil.copy(tracked, made.with_name("model.mcap"))  # a result serves as a model, too
    few = ("--passes", "1", "--end", "4", "--load-model", tracked)
    assert mono(made, made.with_name("r.mcap"), *few) == 0
    np.testing.assert_array_equal(load_arrays(made.with_name("r.mcap"))["position"], mine["position"][:4])


def test_the_skin_tells_in_a_second_pass_alone(
    made: Path, tracked: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Kept often enough that these few frames make a map."""
    map_skin_soon(monkeypatch, 50_000_000)
    for name, more in (("skin", ()), ("points", ("--set", "skin.use=false"))):
        assert mono(made, tmp_path / f"{name}.mcap", *more) == 0
    skin, points = (load_arrays(tmp_path / f"{name}.mcap") for name in ("skin", "points"))
    for name in ("status", "stamp_ns"):
        np.testing.assert_array_equal(skin[name], points[name])
    paths = tracked, tmp_path / "points.mcap", tmp_path / "skin.mcap"  # one pass, and two
    shares = [read_result(path).numbers()["skin_share"] for path in paths]
    assert [np.nanmax(one) > 0.0 for one in shares] == [False, False, True]
    apart = np.any(skin["quaternion"] != points["quaternion"], axis=1)
    assert apart.any() and np.all(apart[skin["status"] == "tracking"])


@pytest.mark.parametrize("when", ["start", "never"])
def test_a_person_need_not_be_adjusted(made: Path, tracked: Path, tmp_path: Path, when: str) -> None:
    assert mono(made, tmp_path / "r.mcap", "--passes", "1", "--adjust", when) == 0
    identities = read_result(tmp_path / "r.mcap").numbers()["identity_1"]
    known = identities[np.isfinite(identities)]
    assert len(known) and np.all(known == known[0])
    adjusted = read_result(tracked).numbers()["identity_1"]
    assert len(set(adjusted[np.isfinite(adjusted)])) > 1


def test_a_second_face_that_is_not_there_is_one_line(
    made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert mono(made, tmp_path / "r.mcap", "--face", "2", "--end", "2") == EXIT_DATA_LOST
    (told,) = lines(capsys)
    assert "no face found, found 2 frames searched" in told and "1 face, not 2" in told
    assert not list(tmp_path.iterdir())


def test_the_smaller_of_two_faces_can_be_asked_for(images: list[np.ndarray], tmp_path: Path) -> None:
    """Beside the face stands the same one at 0.6 of its size."""
    images = images[: FRAMES // 2]
    both = [np.hstack([image, np.zeros_like(image)]) for image in images]
    for image, whole in zip(images, both, strict=True):
        small = cv2.resize(image, None, fx=0.6, fy=0.6, interpolation=cv2.INTER_AREA)
        whole[: small.shape[0], 640 : 640 + small.shape[1]] = small
    video = write_video(tmp_path / "both.avi", both)
    distances = []
    for face in (1, 2):
        options = ("--passes", "1", "--face", face, "--fov", 40)
        assert mono(video, tmp_path / f"{face}.mcap", *options) == 0
        result = load_arrays(tmp_path / f"{face}.mcap")
        assert not np.any(result["status"] == "lost")
        assert np.all(np.sign(result["position"][:, 0]) == (-1.0 if face == 1 else 1.0))
        distances.append(float(np.median(result["position"][:, 2])))
    assert distances[1] / distances[0] == pytest.approx(1 / 0.6, rel=0.1)


def test_a_video_that_was_cut_is_tracked_as_far_as_it_goes(
    video: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cut = tmp_path / "cut.avi"
    data = video.read_bytes()
    cut.write_bytes(data[: len(data) * 3 // 4])
    assert mono(cut, tmp_path / "r.mcap", "--passes", "2") == 3
    count = len(load_arrays(tmp_path / "r.mcap")["status"])
    assert 5 < count < FRAMES
    missing = f"video frame missing: {FRAMES - count}, first frame {count} of {FRAMES}"
    assert lines(capsys)[-1] == f"{cut}: {missing}"


def test_clicked_points_begin_a_run(made: Path, tracked: Path, tmp_path: Path) -> None:
    camera, first = read_result(tracked).camera(), load_arrays(tracked)["points"][0]
    pixels = camera.pixels_from_points(first)[0].round().tolist()
    rows = [f"{camera.name},{name},{x},{y}" for name, (x, y) in zip(POINT_NAMES, pixels, strict=True)]
    (tmp_path / "clicked.csv").write_text("\n".join(["camera,point,x,y", *rows]))
    assert mono(made, tmp_path / "r.mcap", "--passes", "1", "--init", tmp_path / "clicked.csv") == 0
    record = read_result(tmp_path / "r.mcap").run
    assert record["init"] == "clicked.csv" and len(record["init.sha256"]) == 64
    assert table(tmp_path / "r.mcap")["rotation_deg"] < 3.0


def test_landmarks_from_elsewhere_begin_a_run_at_the_features_near_them(
    made: Path, tracked: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """True points with noise, and some wild ones, of all frames but the last."""
    truth = load_arrays(tracked, "/truth/head/estimate")["points"]
    rng, camera = np.random.default_rng(1), open_recording(made, "grey").cameras[0]
    pixels = np.array([camera.pixels_from_points(points)[0] for points in truth])
    pixels += rng.normal(0.0, 0.5, pixels.shape)
    pixels[2, 3] += 50.0
    rows = [
        f"{t},{name},{x:.3f},{y:.3f}"
        for t, frame in enumerate(pixels[:-1])
        for name, (x, y) in zip(POINT_NAMES, frame, strict=True)
    ]
    (tmp_path / "told.csv").write_text("\n".join(["frame,point,x,y", *rows]))
    output = tmp_path / "r.mcap"
    assert mono(made, output, "--passes", "1", "--landmarks", tmp_path / "told.csv") == 0
    said = lines(capsys)[0]
    assert "11 faces by frame number, in px" in said and said.endswith("1 outlier ignored")
    record, found = read_result(output).run, load_arrays(output)
    assert (record["landmarks"], record["landmarks.unit"]) == ("told.csv", "px")
    assert len(record["landmarks.sha256"]) == 64
    first = camera.pixels_from_points(found["points"][0])[0]
    eye_distance_px = np.linalg.norm(pixels[0, :2].mean(axis=0) - pixels[0, 2:4].mean(axis=0))
    np.testing.assert_allclose(first, pixels[0], atol=0.16 * eye_distance_px)  # at features near them
    assert table(output)["rotation_deg"] < 3.0


def test_the_tracker_goes_on_from_its_checkpoints_to_the_same_bytes(
    made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Stopped while the face is collected, later in the first pass, and in the second: one run.

    The skin is kept so often that there is a map of it, though of its frames some went.
    """
    map_skin_soon(monkeypatch, 30_000_000, most=5)
    config = HeadMonoConfig.model_validate({"particles": {"count": 50}, "output": {"flush_frames": 2}})
    begun = []
    source = open_recording(made, "grey")
    (camera,) = source.cameras

    def track(name: str, stop_after: int = 0, *, resume: bool = False) -> RunOutcome:
        asked = iter(range(1, 1000))
        return HeadRun(
            source,
            config,
            HeadRunOptions(tmp_path / name, resume=resume),
            name="head-mono",
            subject=with_dense_face(mono_subject(camera.name, load_face_model())),
            flush_frames=config.output.flush_frames,
            make_tracker=lambda known: begun.append(known) or make_mono_tracker(config, camera, known),
        ).track(lambda estimate: None, lambda: next(asked) == stop_after)

    track("whole.mcap")
    assert "person0.skin_map.points" in begun[-1]
    assert track("cut.mcap", 3).stopped
    assert track("cut.mcap", 4, resume=True).stopped
    assert not list(read_result(part_path(tmp_path / "cut.mcap")).estimates())  # the second pass is written
    assert track("cut.mcap", 8, resume=True).stopped
    assert list(read_result(part_path(tmp_path / "cut.mcap")).estimates())
    assert track("cut.mcap", resume=True).tracked < FRAMES
    assert "person0.skin_map.points" in begun[-1]
    assert filecmp.cmp(tmp_path / "whole.mcap", tmp_path / "cut.mcap", shallow=False)


def test_images_of_depth_are_told_from_faces(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "depth"
    folder.mkdir()
    rng = np.random.default_rng(1)
    for index in range(2):
        depth = rng.integers(600, 4000, (CAMERA.height, CAMERA.width), dtype=np.uint16)
        cv2.imwrite(str(folder / f"{index:06d}.png"), depth)
    assert mono(folder, tmp_path / "r.mcap", "--fps", "30") == EXIT_DATA_LOST
    assert lines(capsys)[-1].endswith("; if these are depth images, use posetrack hand run")
