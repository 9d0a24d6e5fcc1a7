"""Units of stored depth by what images hold, and topics and folders that hold no depth by their names."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from posetrack_cli.errors import RecordingError
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.recording.depth import (
    DepthContent,
    content_of,
    decide_unit,
    likely_units,
    other_content,
    range_words,
)
from posetrack_cli.recording.opening import describe, open_recording

SIZE = 64, 48
CAMERA = Camera(*SIZE, 50.0, 50.0, 31.5, 23.5)
CAMERA_TOML = "fx = 50.0\nfy = 50.0\ncx = 31.5\ncy = 23.5\n"
HAND_MM = 600.0


def scene(wall_mm: float = 2400.0, hand_mm: float = HAND_MM, seed: int = 0) -> np.ndarray:
    """A bowl as large as a hand, 150 mm deep, before a slanted wall, whole mm with noise of a sensor."""
    rng = np.random.default_rng(seed)
    down, across = np.mgrid[: SIZE[1], : SIZE[0]]
    depth = wall_mm + 4.0 * across + rng.normal(0.0, 3.0, (SIZE[1], SIZE[0]))
    # at 0.6 m 14 pixels are 168 mm
    away = np.hypot(across - 31.5, down - 23.5)
    depth = np.where(away < 7.0, hand_mm + 20.0 * away + rng.normal(0.0, 2.0, depth.shape), depth)
    depth[:, :4] = 0.0
    return np.rint(depth)


def hand_alone(seed: int = 0) -> np.ndarray:
    depth = scene(seed=seed)
    return np.where(depth < 1000.0, depth, 0.0)


def decided(*images: np.ndarray, given_mm: float | None = None) -> float:
    return decide_unit(content_of(images, CAMERA), given_mm).unit_mm


SCENES = {"a room": scene, "a hand alone": hand_alone}


@pytest.mark.parametrize("make_scene", SCENES.values(), ids=SCENES)
@pytest.mark.parametrize(("factor", "unit_mm"), [(1, 1.0), (4, 0.25), (5, 0.2), (8, 0.125), (10, 0.1)])
def test_whole_millimetres_in_a_finer_unit_are_known_by_their_divisor(
    make_scene, factor: int, unit_mm: float
) -> None:
    assert decided((factor * make_scene()).astype(np.uint16)) == unit_mm


@pytest.mark.parametrize("make_scene", SCENES.values(), ids=SCENES)
@given(factor=st.integers(1, 10), seed=st.integers(0, 20))
def test_no_unit_is_changed_to_a_wrong_one(make_scene, factor: int, seed: int) -> None:
    """The scaling law: data times a factor has that unit's inverse, or is left as it is by convention."""
    assert decided((factor * make_scene(seed=seed)).astype(np.uint16)) in (1.0, 1.0 / factor)


@pytest.mark.parametrize("make_scene", SCENES.values(), ids=SCENES)
@given(unit_mm=st.sampled_from([0.1, 0.11, 0.25, 0.5]), seed=st.integers(0, 20))
def test_a_finer_unit_without_a_divisor_is_never_applied(make_scene, unit_mm: float, seed: int) -> None:
    """A sensor of tenths of a millimetre: codes are any numbers, and only words name the unit."""
    rng = np.random.default_rng(seed)
    depth = make_scene(seed=seed)
    codes = np.rint((depth + rng.uniform(-0.5, 0.5, depth.shape)) / unit_mm) * (depth > 0)
    content = content_of([codes.astype(np.uint16)], CAMERA)
    assert decide_unit(content).unit_mm == 1.0
    if unit_mm == 0.1:
        assert 0.1 in likely_units(content) and 1.0 not in likely_units(content)


@pytest.mark.parametrize("make_scene", SCENES.values(), ids=SCENES)
@pytest.mark.parametrize("player", [1, 3, 6])
def test_player_numbers_below_the_depth(make_scene, player: int) -> None:
    """Depth << 3 | player, of a player that is the hand; of nobody the number is 0."""
    depth = make_scene().astype(np.uint16)
    codes = depth << 3 | np.where((depth > 0) & (depth < 1000), player, 0).astype(np.uint16)
    decision = decide_unit(content_of([codes], CAMERA))
    assert decision.unit_mm == 0.125
    assert (
        "Kinect v1 player indices" in decision.remark and "override with --depth-unit-mm" in decision.remark
    )


@pytest.mark.parametrize("make_scene", SCENES.values(), ids=SCENES)
def test_floats_are_metres_or_millimetres(make_scene) -> None:
    depth = make_scene().astype(np.float32)
    depth[depth == 0] = np.nan
    assert decided(depth) == 1.0
    assert decided(depth / np.float32(1000)) == 1000.0


# one row a decision: what is stored, what is stated, the unit and a word of the remark
MM = {"images": 1, "share": 0.9, "values": 500}
FINE = {**MM, "near": 6000.0, "middle": 24000.0, "far": 30000.0, "surface": 1500.0}
FLOATS = {"images": 1, "is_float": True, "share": 0.9}
TABLE = {
    "millimetres": ({**MM, "near": 600.0, "middle": 2000.0, "far": 3000.0, "surface": 150.0}, None, 1.0),
    "coarse millimetres of a near hand": (
        {**MM, "near": 600.0, "middle": 2000.0, "far": 3000.0, "surface": 150.0, "step": 10},
        None,
        1.0,
    ),
    "coarse millimetres of a room": (
        {**MM, "near": 2500.0, "middle": 4000.0, "far": 5000.0, "surface": 3000.0, "step": 5},
        None,
        1.0,
    ),
    "a tenth of a millimetre, far": ({**FINE, "step": 10}, None, 0.1),
    "no divisor": (FINE, None, 1.0),
    "few values": ({**FINE, "step": 10, "values": 20}, None, 1.0),
    "labels": ({**FINE, "labels_alike": 0.99, "labelled": 0.3}, None, 0.125),
    "labels as of any depth": ({**FINE, "labels_alike": 0.5, "labelled": 0.87}, None, 1.0),
    "labels of a near hand": ({**FINE, "near": 600.0, "labels_alike": 0.99, "labelled": 0.3}, None, 1.0),
    "stated against what is certain": ({**FINE, "step": 10}, 0.25, 0.25),
    "metres": ({**FLOATS, "near": 0.5, "middle": 2.0, "far": 4.0}, None, 1000.0),
    "metres of a stereo camera in the open": (
        {**FLOATS, "near": 2.0, "middle": 300.0, "far": 5000.0},
        None,
        1000.0,
    ),
    "floats in mm": ({**FLOATS, "near": 500.0, "middle": 2000.0, "far": 4000.0}, None, 1.0),
    "floats in mm, stated in m": ({**FLOATS, "near": 500.0, "middle": 2000.0, "far": 4000.0}, 0.001, 1.0),
    "metres, stated as 1 mm": ({**FLOATS, "near": 0.5, "middle": 2.0, "far": 4.0}, 1.0, 1000.0),
    "TUM's unit, stated in m": ({**FINE, "step": 5}, 0.0002, 0.2),
    "nothing read": ({}, None, 1.0),
    "nothing read, stated": ({}, 0.25, 0.25),
}


@pytest.mark.parametrize(("values", "given_mm", "unit_mm"), TABLE.values(), ids=TABLE)
def test_decisions(values: dict[str, float], given_mm: float | None, unit_mm: float) -> None:
    content = DepthContent(**values)
    decision = decide_unit(content, given_mm)
    assert decision.unit_mm == pytest.approx(unit_mm)
    usual = content.convention_mm if given_mm is None else given_mm
    assert bool(decision.remark) == (unit_mm != pytest.approx(usual))


def test_nearest_surface_is_not_a_speck() -> None:
    depth = scene()
    depth[10, 10:14] = 200.0
    content = content_of([depth.astype(np.uint16)], CAMERA)
    # in the bowl, which is 600 to 740 mm away, and 14 pixels of 12 to 15 mm across
    assert 600.0 <= content.near < 700.0
    assert 100.0 < content.surface < 200.0


@pytest.mark.parametrize(
    ("low_mm", "high_mm", "words"),
    [(0.6, 0.8, "0.6 to 0.8 mm"), (480.0, 660.0, "0.48 to 0.66 m"), (4800.0, 6600.0, "4.8 to 6.6 m")],
)
def test_ranges_for_people(low_mm: float, high_mm: float, words: str) -> None:
    assert range_words(low_mm, high_mm) == words


@pytest.mark.parametrize(
    ("name", "word"),
    [
        ("/ir/image_raw", "ir"),
        ("/camera/infra1/image_rect_raw", "infra"),
        ("/device_0/sensor_0/Infrared_1/image/data", "infrared"),
        ("/kinect2/sd/image_ir", "ir"),
        ("/camera/depth/confidence", "confidence"),
        ("/tof/amplitude/compressed", "amplitude"),
        ("/stereo/disparity", "disparity"),
        ("infrared", "infrared"),
        ("/camera/depth/image_rect_raw", ""),
        ("/device_0/sensor_0/Depth_0/image/data", ""),
        ("/ir_depth/image", ""),
        ("/first/image", ""),
        ("/air/image_raw", ""),
        ("/camera/image/compressedDepth", ""),
    ],
)
def test_names_of_what_is_not_depth(name: str, word: str) -> None:
    assert other_content(name) == word


# Recordings


def write(make: SimpleNamespace, path: Path, topic: str, encoding: str, images: list[np.ndarray]) -> Path:
    info = make.calibration_fields(*SIZE)
    info["K"] = [50.0, 0.0, 31.5, 0.0, 50.0, 23.5, 0.0, 0.0, 1.0]
    messages = [("/cam/calibration", "CameraInfo", 1, 1, info)]
    messages += [
        (topic, "Image", stamp, stamp, make.raw_fields(image, encoding))
        for stamp, image in zip(make.stamps(len(images)), images, strict=True)
    ]
    return make.write_foxglove(path, messages)


def first_depth(path: Path, **options) -> np.ndarray:
    return next(iter(open_recording(path, **options).frames())).depth


@pytest.mark.parametrize(
    ("options", "remark"),
    [
        ({}, "floats are in millimetres"),
        ({"depth_unit_mm": 1.0}, ""),
        ({"depth_unit_mm": 0.001}, "assuming 0.001 m, i.e. 1 mm per stored unit"),
    ],
)
def test_floats_in_mm_on_a_topic(
    tmp_path: Path, make: SimpleNamespace, options: dict[str, float], remark: str
) -> None:
    depth = scene().astype(np.float32)
    path = write(make, tmp_path / "r.mcap", "/depth", "32FC1", [depth] * 3)
    recording = open_recording(path, **options)
    np.testing.assert_array_equal(next(iter(recording.frames())).depth, depth)
    assert remark in "".join(recording.remarks) and bool(recording.remarks) == bool(remark)
    assert recording.identity()["depth_unit_mm"] == "1.0"
    camera = tmp_path / "camera.toml"
    for unit in (1.0, 0.001):
        camera.write_text(CAMERA_TOML + f"depth_unit_mm = {unit}\n")
        np.testing.assert_array_equal(first_depth(path, camera_file=camera), depth)


def test_a_unit_by_convention_is_not_in_the_record(tmp_path: Path, make: SimpleNamespace) -> None:
    """So that records of recordings that were always read so stay as they were."""
    depth = scene().astype(np.float32) / np.float32(1000)
    recording = open_recording(write(make, tmp_path / "r.mcap", "/depth", "32FC1", [depth]))
    assert not {"depth_unit_mm", "missing"} & recording.identity().keys()
    assert recording.remarks == ()


def test_missing_and_unit_of_a_topic_of_integers(tmp_path: Path, make: SimpleNamespace) -> None:
    codes = scene().astype(np.uint16)
    missing = int(codes[0, 10])
    path = write(make, tmp_path / "r.mcap", "/depth", "16UC1", [codes])
    expected = np.where(codes == missing, 0.0, 0.5 * codes)
    np.testing.assert_array_equal(first_depth(path, depth_unit_mm=0.5, missing=missing), expected)
    assert open_recording(path, missing=missing).identity()["missing"] == str(missing)


def test_a_topic_of_infrared_is_refused_and_taken_all_the_same(tmp_path: Path, make: SimpleNamespace) -> None:
    path = write(make, tmp_path / "r.mcap", "/ir/image_raw", "mono16", [scene().astype(np.uint16)])
    with pytest.raises(RecordingError, match="no depth topic, found /ir/image_raw") as caught:
        open_recording(path)
    assert "named ir" in str(caught.value)
    assert str(caught.value).endswith("if it is depth, pass --topic /ir/image_raw")
    np.testing.assert_array_equal(first_depth(path, topic="/ir/image_raw"), scene())
    (topic,) = [topic for topic in describe(path)["topics"] if topic["topic"] == "/ir/image_raw"]
    assert topic["depth"] is False


def write_floats(folder: Path, images: list[np.ndarray]) -> Path:
    folder.mkdir()
    for number, image in enumerate(images):
        assert cv2.imwrite(str(folder / f"{number:03d}.tiff"), image)
    (folder / "camera.toml").write_text(CAMERA_TOML)
    return folder


@pytest.mark.parametrize(("name", "unit"), [("m", 1000.0), ("mm", 1.0)])
def test_a_folder_of_float_tiff(tmp_path: Path, name: str, unit: float) -> None:
    depth = scene().astype(np.float32)
    folder = write_floats(tmp_path / name, [depth / np.float32(unit)] * 2)
    recording = open_recording(folder, fps=30.0)
    np.testing.assert_allclose(next(iter(recording.frames())).depth, depth, rtol=1e-6)  # of float32
    assert float(recording.identity()["depth_unit_mm"]) == unit
    assert describe(folder)["cameras"][0]["depth_unit_mm"] == unit
    reopened = open_recording(folder, fps=30.0, depth_unit_mm=unit)
    assert reopened.remarks == () and reopened.identity() == recording.identity()


def test_integers_among_floats_are_left_out(tmp_path: Path) -> None:
    folder = write_floats(tmp_path / "both", [scene().astype(np.float32), scene().astype(np.uint16)])
    recording = open_recording(folder, fps=30.0)
    assert [frame.index for frame in recording.frames()] == [0]
    assert (
        recording.losses[0].what
        == "image skipped, values are 16-bit integers, not 32-bit floats like the first"
    )


def test_a_folder_called_infrared_is_refused(tmp_path: Path, make: SimpleNamespace) -> None:
    folder = make.write_folder(tmp_path / "ir", [scene().astype(np.uint16)], camera=CAMERA_TOML)
    with pytest.raises(
        RecordingError, match="folder is named 'ir', so its images are not read as depth"
    ) as caught:
        open_recording(folder)
    assert str(caught.value).endswith("if they are depth, pass --depth-unit-mm, e.g. 1")
    np.testing.assert_array_equal(first_depth(folder, depth_unit_mm=1.0), scene())


FOCAL_PX, BASELINE_M = 50.0, 0.075


def disparity_of(depth: np.ndarray) -> np.ndarray:
    with np.errstate(divide="ignore"):
        disparity = FOCAL_PX * BASELINE_M * 1000.0 / depth
    return np.where(depth > 0, disparity, -1.0).astype(np.float32)


def test_disparity_becomes_depth_by_the_right_camera_s_projection(
    tmp_path: Path, make: SimpleNamespace
) -> None:
    """z = f B / d, B from P of the right camera: -f B in its fourth place."""
    info = make.calibration_fields(*SIZE)
    info["K"] = [FOCAL_PX, 0.0, 31.5, 0.0, FOCAL_PX, 23.5, 0.0, 0.0, 1.0]
    info["P"] = [FOCAL_PX, 0.0, 31.5, 0.0, 0.0, FOCAL_PX, 23.5, 0.0, 0.0, 0.0, 1.0, 0.0]
    right = {**info, "P": [*info["P"][:3], -FOCAL_PX * BASELINE_M, *info["P"][4:]]}
    image = ("/stereo/disparity", "Image", 5, 5, make.raw_fields(disparity_of(scene()), "32FC1"))
    cameras = [
        ("/stereo/left/camera_info", "CameraInfo", 1, 1, info),
        ("/stereo/right/camera_info", "CameraInfo", 1, 1, right),
    ]
    path = make.write_foxglove(tmp_path / "r.mcap", [*cameras, image])
    recording = open_recording(path, camera_topic="/stereo/left/camera_info")
    np.testing.assert_allclose(next(iter(recording.frames())).depth, scene(), rtol=1e-6)  # of float32
    assert "holds disparity" in recording.remarks[0]
    alone = make.write_foxglove(tmp_path / "alone.mcap", [cameras[0], image])
    with pytest.raises(RecordingError, match="disparity cannot be converted to depth") as caught:
        open_recording(alone)
    assert "no baseline" in str(caught.value) and "the baseline in P" in str(caught.value)


@pytest.mark.parametrize("ros", [1, 2])
def test_disparity_images_state_what_turns_them_into_depth(
    tmp_path: Path, make: SimpleNamespace, ros: int
) -> None:
    """stereo_msgs/DisparityImage: header, image, f, T (t in ROS 2), valid window, limits."""
    disparity = disparity_of(scene())
    path = make.write_disparity(tmp_path / "r.mcap", ros, disparity, FOCAL_PX, BASELINE_M)
    camera = tmp_path / "camera.toml"
    camera.write_text(CAMERA_TOML)
    # T is stored as float32
    np.testing.assert_allclose(first_depth(path, camera_file=camera), scene(), rtol=1e-6)
