"""Image points against OpenCV's projection, joint angles against the joints, ranges of made motions."""

from __future__ import annotations

import csv
import io
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from posetrack_cli.errors import ResultError
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.model.anatomy import FINGERS
from posetrack_cli.results import ResultWriter, read_result
from posetrack_cli.results.derived import joint_angle_names, joint_angles, pixels, range_of_motion
from posetrack_cli.results.export.export import export_file, text_pieces
from posetrack_cli.results.export.source import export_source
from support.hand_results import FRAMES, STEP_NS, hand, poses, write
from support.hand_results import SUBJECT as HAND
from support.results import CAMERA, RUN, SUBJECT, make_estimate, with_fields

PIXEL_ERROR = 1e-6  # px; of sums of some float64 products at 1000 px
ANGLE_ERROR_DEG = 1e-9  # joints at 1000 mm are exact to 1e-13 mm, bones are longer than 10 mm
PLACE = np.hstack([Rotation.from_rotvec([0.02, -0.3, 0.05]).as_matrix(), [[-120.0], [4.0], [7.0]]])
RIG = (
    CAMERA,
    replace(
        CAMERA,
        name="side",
        cx=250.0,
        distortion=(-0.2, 0.05, 1e-3, -2e-3, 0.01),
        camera_T_reference=PLACE.tolist(),
    ),
)


def projected(camera: Camera, points: np.ndarray) -> np.ndarray:
    """OpenCV's pixels (..., 2) of points (..., 3) in axes of the reference camera."""
    place = np.array(camera.camera_T_reference)
    turn, _ = cv2.Rodrigues(place[:, :3])
    distortion = np.array(camera.distortion)
    flat, _ = cv2.projectPoints(points.reshape(-1, 1, 3), turn, place[:, 3], camera.matrix, distortion)
    return flat.reshape(*points.shape[:-1], 2)


def expected_pixels(camera: Camera, columns: dict[str, np.ndarray]) -> np.ndarray:
    found = projected(camera, columns["points"])
    found[columns["status"] == "lost"] = np.nan
    return found


def test_points_are_where_opencv_projects_them(tmp_path: Path) -> None:
    result = read_result(write(tmp_path / "r.mcap", hand("right"), lost=(5, 6)))
    arrays = result.to_numpy()
    expected = expected_pixels(CAMERA, arrays)
    assert np.isnan(expected[5:7]).all() and np.isfinite(expected[7:]).all()
    np.testing.assert_allclose(arrays["pixels"][:, 0], expected, rtol=0, atol=PIXEL_ERROR)
    rows = list(csv.DictReader(io.StringIO("".join(text_pieces(export_source(result), "csv")))))
    tip = result.subject.point_names.index("index_tip")
    written = [[float(row[f"index_tip_{axis}_px"] or "nan") for axis in "uv"] for row in rows]
    np.testing.assert_array_equal(written, arrays["pixels"][:, 0, tip])


def test_each_camera_of_a_rig_has_its_own_pixels(tmp_path: Path) -> None:
    with ResultWriter(tmp_path / "r.mcap", SUBJECT, CAMERA, RUN, others=RIG[1:]) as writer:
        for index in range(8):
            points = make_estimate(index).points + np.array([0.0, 0.0, 900.0])
            writer.write(with_fields(make_estimate(index), points=points))
        writer.finish({})
    result = read_result(tmp_path / "r.mcap")
    arrays = result.to_numpy()
    for k, camera in enumerate(RIG):
        np.testing.assert_allclose(
            arrays["pixels"][:, k], expected_pixels(camera, arrays), rtol=0, atol=PIXEL_ERROR
        )
    dataset, table = result.to_xarray(), result.to_pandas()
    wrist = dataset["pixels"].sel(camera="side", point="wrist", pixel="v")
    np.testing.assert_array_equal(table["wrist_in_side_v_px"], wrist)
    np.testing.assert_array_equal(table["thumb_cmc_in_camera_u_px"], arrays["pixels"][:, 0, 3, 0])
    assert dataset["pixels"].attrs["units"] == "px"
    export_file(export_source(result), "npz", tmp_path / "r.npz")
    with np.load(tmp_path / "r.npz") as file:
        np.testing.assert_array_equal(file["pixels"], arrays["pixels"])
        assert file["camera_names"].tolist() == ["camera", "side"]


def test_a_fisheye_is_projected_like_opencv_does() -> None:
    camera = Camera(640, 480, 300.0, 301.0, 320.0, 239.0, (0.05, -0.01, 2e-3, -1e-4), "equidistant")
    points = np.random.default_rng(0).uniform([-900, -700, 300], [900, 700, 1500], (3, 7, 3))
    flat, _ = cv2.fisheye.projectPoints(
        points.reshape(-1, 1, 3), np.zeros(3), np.zeros(3), camera.matrix, np.array(camera.distortion)
    )
    columns = {"points": points, "status": np.array(["tracking"] * 3)}
    np.testing.assert_allclose(pixels(columns, camera), flat.reshape(3, 7, 2), rtol=0, atol=PIXEL_ERROR)


def test_nothing_behind_the_camera_has_pixels() -> None:
    points = np.array([[[0.0, 0.0, 500.0], [10.0, 0.0, -500.0], [10.0, 5.0, 0.0]]])
    found = pixels({"points": points, "status": np.array(["tracking"])}, CAMERA)[0]
    np.testing.assert_allclose(found[0], [CAMERA.cx, CAMERA.cy])
    assert np.isnan(found[1:]).all()


# Joint angles, from the joints alone


def between(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Angles, deg, 0 to 180, between bones (F, 3)."""
    across = np.linalg.norm(np.cross(first, second), axis=1)
    return np.degrees(np.arctan2(across, np.sum(first * second, axis=1)))


def angles_of_joints(points: np.ndarray, quaternions: np.ndarray, side: str) -> dict[str, np.ndarray]:
    """Angles, deg, that bones between joints (F, 21, 3) span; ``thumb_mcp`` is in any direction."""
    in_hand, rest = Rotation.from_quat(quaternions).inv(), hand(side).base_rotations
    found: dict[str, np.ndarray] = {}
    for f, finger in enumerate(FINGERS):
        bones = np.diff(points[:, 1 + 4 * f : 5 + 4 * f], axis=1)
        middle, last = (between(bones[:, k], bones[:, k + 1]) for k in (0, 1))
        if finger == "thumb":
            found |= {"thumb_mcp": middle, "thumb_ip_flexion": last}
            continue
        x, y, z = (in_hand.apply(bones[:, 0]) @ rest[f]).T  # at rest along -y, and the palm faces -z
        found |= {f"{finger}_pip_flexion": middle, f"{finger}_dip_flexion": last}
        found[f"{finger}_mcp_flexion"] = np.degrees(np.arctan2(-z, np.hypot(x, y)))
        # A finger at 90 deg points along the axis of its abduction.
        abducted = np.degrees(np.arctan2(x if side == "right" else -x, -y))
        found[f"{finger}_mcp_abduction"] = np.where(np.hypot(x, y) > 1.0, abducted, np.nan)
    return found


@pytest.mark.parametrize("inner", [False, True])
@pytest.mark.parametrize("side", ["right", "left"])
def test_angles_are_those_between_the_bones(tmp_path: Path, side: str, inner: bool) -> None:
    result = read_result(write(tmp_path / "r.mcap", hand(side), inner=inner))
    arrays = result.to_numpy()
    angles = dict(zip(result.angle_names, arrays["joint_angles_deg"].T, strict=True))
    expected = angles_of_joints(arrays["points"], arrays["quaternion"], side)
    flexion, abduction = (np.radians(angles[f"thumb_mcp_{kind}"]) for kind in ("flexion", "abduction"))
    angles["thumb_mcp"] = np.degrees(np.arccos(np.cos(abduction) * np.cos(flexion)))
    for name, values in expected.items():
        known = np.isfinite(values)
        assert known.sum() > FRAMES // 2
        found = np.abs(angles[name]) if name == "thumb_ip_flexion" else angles[name]  # which extends, too
        np.testing.assert_allclose(found[known], values[known], rtol=0, atol=ANGLE_ERROR_DEG, err_msg=name)
    assert len(result.angle_names) == 21
    np.testing.assert_array_equal(result.to_pandas()["index_dip_flexion_deg"], angles["index_dip_flexion"])
    dataset = result.to_xarray()["joint_angles_deg"]
    np.testing.assert_array_equal(dataset.sel(angle="thumb_ip_flexion"), angles["thumb_ip_flexion"])


def test_angles_of_the_pose_are_its_own(tmp_path: Path) -> None:
    anatomy = hand("left")
    arrays = read_result(write(tmp_path / "r.mcap", anatomy)).to_numpy()
    names = joint_angle_names(HAND)
    for k, name in enumerate(HAND.shape_names):
        found = arrays["joint_angles_deg"][:, names.index(name)]
        np.testing.assert_allclose(np.radians(found), poses(anatomy)[:, 7 + k], rtol=1e-14)
    assert joint_angle_names(SUBJECT) == ()
    assert "joint_angles_deg" not in read_result(write_small(tmp_path / "s.mcap")).to_numpy()


def write_small(path: Path, name: str = "hand") -> Path:
    with ResultWriter(path, replace(SUBJECT, name=name, triangles=None), CAMERA, RUN) as writer:
        writer.write(make_estimate(0))
        writer.finish({})
    return path


# Range of motion


def columns_of(angle_deg: np.ndarray, stamps_ns: np.ndarray, **status: str) -> dict[str, np.ndarray]:
    """A hand all angles of which go the same way; status by frame, such as ``f3="lost"``."""
    count = len(HAND.shape_names)
    states = [status.get(f"f{k}", "tracking") for k in range(len(angle_deg))]
    return {
        "stamp_ns": stamps_ns,
        "status": np.array(states),
        "shape": np.repeat(np.radians(angle_deg)[:, None], count, axis=1),
    }


def test_range_and_speed_of_a_ramp() -> None:
    """30 deg/s with a dropped frame: quantiles of a uniform distribution, and one speed."""
    steps = np.array([*range(0, 40), *range(41, 102)])
    table = range_of_motion(columns_of(steps * 1.0, steps * STEP_NS), HAND)
    row = {name: values[table["angle"].tolist().index("index_mcp_flexion")] for name, values in table.items()}
    assert (row["minimum_deg"], row["maximum_deg"], row["frames"]) == (0.0, pytest.approx(101.0), 101)
    np.testing.assert_allclose([row["q05_deg"], row["q95_deg"]], np.quantile(steps, [0.05, 0.95]))
    assert row["median_deg"] == pytest.approx(51.0)
    rate = 1e9 / STEP_NS
    np.testing.assert_allclose([row["q95_speed_deg_s"], row["peak_speed_deg_s"]], rate)
    dip = table["angle"].tolist().index("ring_dip_flexion")
    assert table["maximum_deg"][dip] == pytest.approx(50.5) and table["peak_speed_deg_s"][
        dip
    ] == pytest.approx(rate / 2)


def test_lost_frames_and_jumps_of_a_reinitialisation_do_not_count() -> None:
    angles = np.array([0.0, 1.0, 80.0, 80.0, 40.0, 41.0, 60.0, 61.0])
    stamps = np.arange(8) * STEP_NS
    states = {"f2": "lost", "f3": "lost", "f4": "reinitialised", "f6": "reinitialised"}
    table = range_of_motion(columns_of(angles, stamps, **states), HAND)
    assert table["frames"][0] == 6
    assert table["maximum_deg"][0] == pytest.approx(61.0)
    assert table["peak_speed_deg_s"][0] == pytest.approx(1e9 / STEP_NS)


def test_the_order_of_frames_does_not_matter() -> None:
    rng = np.random.default_rng(3)
    columns = columns_of(rng.uniform(0.0, 90.0, 50), np.arange(50) * STEP_NS, f7="lost")
    backwards = {name: values[::-1] for name, values in columns.items()}
    for name, values in range_of_motion(columns, HAND).items():
        np.testing.assert_array_equal(range_of_motion(backwards, HAND)[name], values)


def test_a_head_has_three_angles_whose_speed_does_not_jump_at_half_a_turn(tmp_path: Path) -> None:
    yaw = np.radians(170.0 + 5.0 * np.arange(5))
    facing = Rotation.from_quat([1.0, 0.0, 0.0, 0.0])
    turned = (Rotation.from_euler("y", yaw[:, None]) * facing).as_quat(canonical=True)
    head = replace(SUBJECT, name="head", triangles=None)
    with ResultWriter(tmp_path / "h.mcap", head, CAMERA, RUN) as writer:
        for index, quaternion in enumerate(turned):
            stamp = index * STEP_NS
            writer.write(
                with_fields(make_estimate(0), quaternion=quaternion, stamp_ns=stamp, frame_index=index)
            )
        writer.finish({})
    table = read_result(tmp_path / "h.mcap").range_of_motion()
    assert table["angle"].tolist() == ["roll", "pitch", "yaw"]
    assert table["peak_speed_deg_s"][2] == pytest.approx(5e9 / STEP_NS)
    rows = list(
        csv.reader(io.StringIO("".join(text_pieces(export_source(read_result(tmp_path / "h.mcap")), "rom"))))
    )
    assert rows[0] == list(table) and [row[0] for row in rows[1:]] == ["roll", "pitch", "yaw"]
    np.testing.assert_array_equal([float(row[2]) for row in rows[1:]], table["minimum_deg"])


def test_without_tracked_frames_nothing_is_known_of_the_range() -> None:
    columns = columns_of(np.zeros(3), np.arange(3), f0="lost", f1="lost", f2="lost")
    table = range_of_motion(columns, HAND)
    assert table["frames"].tolist() == [0] * 21
    assert np.isnan(table["maximum_deg"]).all() and np.isnan(table["peak_speed_deg_s"]).all()


def test_a_subject_without_angles_has_no_range(tmp_path: Path) -> None:
    with pytest.raises(ResultError, match="a hand has no angles, expected a result of a hand or a head"):
        read_result(write_small(tmp_path / "r.mcap")).range_of_motion()


def test_joint_angles_are_of_every_frame() -> None:
    columns = columns_of(np.arange(FRAMES) * 1.0, np.arange(FRAMES))
    assert joint_angles(columns, HAND).shape == (FRAMES, 21)
