"""The Python interface: arrays are tracked as recordings are, and results read as they were written."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

import posetrack_cli as posetrack
from posetrack_cli.cli.main import run
from posetrack_cli.errors import PosetrackError
from posetrack_cli.hand.autodetect import DetectedHand
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.outputs import part_path
from posetrack_cli.recording.opening import open_recording
from posetrack_cli.results import load_arrays
from posetrack_cli.results.estimate import Estimate
from posetrack_cli.results.export.table import table_of

FRAMES = 6
PYTHON_PAGE = Path(__file__).parents[2] / "docs" / "python.md"
QUICK: dict[str, Any] = {"filter.particles": 32, "output.flush_frames": 2}
SIZE = {"width": 8, "height": 6}
CAMERA = posetrack.Camera(**SIZE, fx=6.0, fy=6.0, cx=3.5, cy=2.5)
STORED = ("position", "quaternion", "shape", "points", "twist", "pose_variance", "twist_variance")


class Depth:
    """A recording, its images as it stores them, and what the command line makes of it."""

    def __init__(self, folder: Path) -> None:
        self.path, self.result = folder / "hand.mcap", folder / "result.mcap"
        synth = ["hand", "synth", "--motion", "C", "--frames", str(FRAMES), "--seed", "3", "--no-drops"]
        assert run([*synth, "-o", str(self.path)]) == 0
        settings = [part for key, value in QUICK.items() for part in ("--set", f"{key}={value}")]
        own = ["--hand-side", "right", "--shape", "average", *settings]
        assert run(["hand", "run", str(self.path), "-o", str(self.result), *own]) == 0
        recording = open_recording(self.path)
        frames = list(recording.frames())
        self.camera = recording.cameras[0]
        self.images = np.stack([frame.depth for frame in frames]).astype(np.uint16)
        self.stamps = [frame.stamp_ns for frame in frames]

    def track(self, **more: Any) -> posetrack.api.Tracking:
        given = {"side": "right", "shape": "average", "settings": QUICK} | more
        return posetrack.track_hand(self.images, self.camera, stamps_ns=self.stamps, **given)


@pytest.fixture(scope="module")
def depth(tmp_path_factory: pytest.TempPathFactory) -> Depth:
    return Depth(tmp_path_factory.mktemp("depth"))


def assert_equal(estimates: list[Estimate], arrays: dict[str, np.ndarray]) -> None:
    assert [estimate.stamp_ns for estimate in estimates] == arrays["stamp_ns"].tolist()
    assert [str(estimate.status) for estimate in estimates] == arrays["status"].tolist()
    for name in STORED:
        np.testing.assert_array_equal([getattr(estimate, name) for estimate in estimates], arrays[name])


def test_arrays_are_tracked_like_the_recording_they_come_from(depth: Depth) -> None:
    with depth.track() as tracking:
        assert tracking.subject.name == "hand" and tracking.outcome is None
        estimates = list(tracking)
    assert_equal(estimates, load_arrays(depth.result))
    assert tracking.outcome is not None and tracking.outcome.frames == FRAMES
    by_path = posetrack.track_hand(depth.path, side="right", shape="average", settings=QUICK)
    assert_equal(list(by_path), load_arrays(depth.result))


def test_the_shape_of_an_earlier_result_is_used(depth: Depth, tmp_path: Path) -> None:
    earlier = tmp_path / "earlier.mcap"
    with depth.track(settings=QUICK | {"hand.scale": 1.1}, output=earlier) as tracking:
        list(tracking)
    again = depth.track(shape=earlier)
    hand = json.loads(again.run["configuration"])["hand"]
    again.close()
    assert hand == json.loads(posetrack.read(earlier).run["configuration"])["hand"]
    assert hand["scale"] == 1.1


def test_a_doubtful_shape_is_a_warning(depth: Depth, monkeypatch: pytest.MonkeyPatch) -> None:
    def doubtful(recording: object, config: HandConfig, *_: object) -> DetectedHand:
        return DetectedHand(config, "shape is uncertain", is_doubtful=True)

    monkeypatch.setattr("posetrack_cli.hand.autodetect.detect_hand", doubtful)
    with pytest.warns(UserWarning, match="shape is uncertain"):
        depth.track().close()


def test_a_run_that_is_closed_can_be_resumed_to_equal_estimates(depth: Depth, tmp_path: Path) -> None:
    output = tmp_path / "hand.mcap"
    with depth.track(output=output) as tracking:
        first = [next(tracking) for _ in range(3)]
    assert part_path(output).exists() and not output.exists()
    rest = list(depth.track(output=output, resume=True))
    kept = FRAMES - len(rest)
    assert 0 < kept <= len(first)
    assert_equal([*first[:kept], *rest], load_arrays(depth.result))
    assert_equal([*first[:kept], *rest], posetrack.read(output).to_numpy())


def test_a_recording_takes_a_camera_as_text(depth: Depth) -> None:
    given: Any = {"camera_file": "kinect2"}
    camera = posetrack.open_recording(depth.path, **given).cameras[0]
    assert camera.fx == posetrack.open_recording(depth.path, camera_file=Path("kinect2")).cameras[0].fx


def test_linear_algebra_has_one_thread_until_the_run_ends(depth: Depth) -> None:
    """With more, rounding would depend on the number of cores, and results differ from the command line's."""

    def threads() -> set[int]:
        return {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}

    import scipy.linalg  # noqa: F401  loads scipy's own library

    with threadpool_limits(2, user_api="blas"):
        with depth.track() as tracking:
            next(tracking)
            assert threads() == {1}
        assert threads() == {2}


def test_nothing_is_left_of_a_run_without_output(depth: Depth, tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with depth.track() as tracking:
        next(tracking)
        assert list(tmp_path.iterdir())
    assert not list(tmp_path.iterdir())


def test_a_head_is_tracked_from_arrays_like_from_its_recording(tmp_path: Path) -> None:
    recording, result = tmp_path / "head.mcap", tmp_path / "result.mcap"
    assert run(["head", "synth", "--frames", "8", "--seed", "1", "-o", str(recording)]) == 0
    assert run(["head", "stereo", str(recording), "-o", str(result)]) == 0
    source = open_recording(recording, "grey")
    frames = list(source.frames())
    images = {camera.name: [frame.images[c] for frame in frames] for c, camera in enumerate(source.cameras)}
    stamps = [frame.stamp_ns for frame in frames]
    assert_equal(list(posetrack.track_head(images, source.cameras, stamps_ns=stamps)), load_arrays(result))
    assert_equal(list(posetrack.track_head(recording)), load_arrays(result))
    assert_equal(list(posetrack.track_head(source)), load_arrays(result))
    for more in ({"fps": 30.0}, {"cameras": source.cameras}, {"fov_deg": 60.0}):
        with pytest.raises(PosetrackError, match=r"does not apply|calibrated camera"):
            posetrack.track_head(source, **more)  # type: ignore[arg-type]
    reference = source.cameras[0]
    alone = ["--cameras", reference.name, "--passes", "1"]
    mono = tmp_path / "mono.mcap"
    assert run(["head", "mono", str(recording), "-o", str(mono), *alone]) == 0
    one_pass = {"settings": {"run.passes": 1}, "stamps_ns": stamps}
    tracking = posetrack.track_head(images[reference.name], reference, **one_pass)
    assert_equal(list(tracking), load_arrays(mono))
    with pytest.raises(PosetrackError, match="person applies to one camera"):
        posetrack.track_head(recording, person=result)
    with pytest.raises(PosetrackError, match="all faces require two passes"):
        posetrack.track_head(recording, faces="all")
    same = posetrack.track_head(images[reference.name], reference, person=result, **one_pass)
    assert same.run["scale"] == "person"
    same.close()


def test_an_uncalibrated_camera_is_guessed_or_given_by_its_field_of_view() -> None:
    images = np.zeros((2, 60, 80), np.uint8)
    tracking = posetrack.track_head(images, fps=30.0, fov_deg=90.0)
    assert json.loads(tracking.run["camera"])["fx"] == pytest.approx(40.0)
    assert tracking.run["intrinsics"] == "guessed"
    tracking.close()
    with pytest.warns(UserWarning, match="focal length estimated as"):
        tracking = posetrack.track_head(images, fps=30.0)
    assert tracking.run["intrinsics"] == "estimated"
    tracking.close()


def test_tables_and_datasets_hold_what_the_arrays_do(depth: Depth) -> None:
    pytest.importorskip("pandas"), pytest.importorskip("xarray")
    result = posetrack.read(depth.result)
    arrays, table, dataset = result.to_numpy(), result.to_pandas(), result.to_xarray()
    names = [name for group in table_of(result.subject, result.image_cameras) for name in group.names]
    assert [table.index.name, *table.columns] == sorted(
        names, key=lambda name: (name != "stamp_ns", names.index(name))
    )
    np.testing.assert_array_equal(table.index, arrays["stamp_ns"])
    np.testing.assert_array_equal(table[["x_mm", "y_mm", "z_mm"]], arrays["position"])
    tip = result.subject.point_names.index("index_tip")
    np.testing.assert_array_equal(table["index_tip_y_mm"], arrays["points"][:, tip, 1])
    np.testing.assert_array_equal(dataset["points"].sel(point="index_tip", axis="y"), table["index_tip_y_mm"])
    np.testing.assert_array_equal(table["index_tip_v_px"], arrays["pixels"][:, 0, tip, 1])
    np.testing.assert_array_equal(
        dataset["pixels"].sel(point="index_tip", pixel="u")[:, 0], table["index_tip_u_px"]
    )
    bent = dataset["joint_angles_deg"].sel(angle="index_pip_flexion")
    np.testing.assert_array_equal(table["index_pip_flexion_deg"], bent)
    np.testing.assert_allclose(np.radians(bent), table["index_pip_flexion_rad"], rtol=1e-15)
    np.testing.assert_array_equal(dataset["twist"].sel(tangent="rz"), arrays["twist"][:, 5])
    assert dataset["status"].values.tolist() == arrays["status"].tolist()
    assert dataset.attrs["seed"] == "0"


def test_an_evaluation_is_that_of_the_command_line(depth: Depth, tmp_path: Path) -> None:
    path = tmp_path / "eval.json"
    assert run(["eval", str(depth.result), "--json", str(path)]) == 0
    evaluation = posetrack.evaluate(depth.result)
    mean = evaluation.metrics["joint_error_mm"].mean
    assert f"{mean:.6g}" in {f"{value:.6g}" for value in numbers_in(json.loads(path.read_text()))}


def numbers_in(value: object) -> Iterator[float]:
    if isinstance(value, dict | list):
        for part in value.values() if isinstance(value, dict) else value:
            yield from numbers_in(part)
    elif isinstance(value, float):
        yield value


IMAGES = np.full((3, SIZE["height"], SIZE["width"]), 600, np.uint16)


@pytest.mark.parametrize(
    ("images", "camera", "times", "expected"),
    [
        (IMAGES, None, {"fps": 30.0}, "camera of the images is missing"),
        (IMAGES, CAMERA, {}, "found neither, expected fps or stamps_ns"),
        (IMAGES, CAMERA, {"fps": 30.0, "stamps_ns": [1, 2, 3]}, "found both"),
        (IMAGES, CAMERA, {"stamps_ns": [1, 2]}, "another length"),
        (IMAGES, CAMERA, {"stamps_ns": [1, 3, 2]}, "do not increase"),
        (IMAGES[:, :-1], CAMERA, {"fps": 30.0}, "found 8x5, expected 8x6"),
        (IMAGES[..., None].repeat(3, -1), CAMERA, {"fps": 30.0}, "not a depth image"),
        (IMAGES > 0, CAMERA, {"fps": 30.0}, "not a depth image"),
        (IMAGES[:0], CAMERA, {"fps": 30.0}, "no frame to track"),
        (iter(IMAGES), CAMERA, {"fps": 30.0}, "can be read only once"),
        (np.zeros((3, 4)), CAMERA, {"fps": 30.0}, "not an image"),
    ],
)
def test_unusable_arrays_are_refused_in_one_line(
    images: Any, camera: posetrack.Camera | None, times: dict[str, Any], expected: str
) -> None:
    with pytest.raises(PosetrackError) as error:
        posetrack.track_hand(images, camera, **times)
    assert expected in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("images", "cameras", "more", "expected"),
    [
        ({"left": IMAGES, "right": IMAGES[:2]}, ("left", "right"), {}, "different numbers of images"),
        ({"left": IMAGES, "right": IMAGES}, ("left",), {}, "images and cameras differ"),
        ({"left": IMAGES, "right": IMAGES}, (), {}, "cameras are missing"),
        (IMAGES, ("left",), {"fov_deg": 60.0}, "mutually exclusive"),
        (IMAGES, (), {"smooth": True}, "smooth needs a result file"),
    ],
)
def test_unusable_images_of_heads_are_refused_in_one_line(
    images: Any, cameras: tuple[str, ...], more: dict[str, Any], expected: str
) -> None:
    rig = [posetrack.Camera(**SIZE, fx=6.0, fy=6.0, cx=3.5, cy=2.5, name=name) for name in cameras]
    with pytest.raises(PosetrackError) as error:
        posetrack.track_head(images, rig, fps=30.0, **more)
    assert expected in str(error.value) and "\n" not in str(error.value)


def test_reading_and_evaluating_need_the_documented_packages_alone(depth: Depth, tmp_path: Path) -> None:
    """With anything else missing, values are those of the whole installation."""
    (line,) = re.findall(r"pip install --no-deps \. (.+?)\n```", PYTHON_PAGE.read_text(), re.DOTALL)
    names = {name.replace("-", "_") for name in line.replace("\\\n", " ").split()}
    assert names.isdisjoint({"numba", "scipy", "opencv_python_headless", "av", "moderngl", "protobuf"})
    allowed = sorted(names | {"posetrack_cli", "org"})  # mcap asks for org.apache, which is nowhere
    code = (
        "import sys, sysconfig\n"
        f"installed, allowed = sysconfig.get_paths()['purelib'], {allowed}\n"
        "class Rest:\n"
        "    def find_spec(self, name, path, target=None):\n"
        "        top = name.split('.')[0]\n"
        "        if top not in {*allowed, *sys.stdlib_module_names} and not top.startswith('_'):\n"
        "            raise ModuleNotFoundError(f'No module named {top}', name=top)\n"
        "sys.meta_path.insert(0, Rest())\n"
        "import posetrack_cli as posetrack\n"
        "from posetrack_cli.cli.main import run\n"
        f"result = posetrack.read({str(depth.result)!r})\n"
        "assert result.to_numpy()['pixels'].size and result.range_of_motion()['frames'].any()\n"
        "sys.exit(run(sys.argv[1:]))"
    )
    reports = []
    for command in ([sys.executable, "-c", code], [sys.executable, "-m", "posetrack_cli"]):
        path = tmp_path / f"{len(reports)}.json"
        arguments = ["eval", str(depth.result), "--json", str(path), "--html", str(path.with_suffix(".html"))]
        subprocess.run([*command, *arguments], capture_output=True, text=True, check=True)
        reports.append(json.loads(path.read_text()))
    assert reports[0] == reports[1]
    with pytest.raises(subprocess.CalledProcessError) as error:
        arguments = ["hand", "run", str(depth.path), "-o", str(tmp_path / "tracked.mcap")]
        subprocess.run([sys.executable, "-c", code, *arguments], capture_output=True, text=True, check=True)
    assert "is not installed; install posetrack with all dependencies\n" in error.value.stderr
