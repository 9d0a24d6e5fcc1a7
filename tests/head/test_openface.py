"""CSV like OpenFace's, with its angles, and its landmarks where OpenCV projects ours."""

from __future__ import annotations

import csv
import io

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from posetrack_cli.geometry.rotations import FACING
from posetrack_cli.head.face.points import FEATURES, LINES, POINT_NAMES
from posetrack_cli.head.openface import euler_xyz, openface_text
from posetrack_cli.results import Result, ResultWriter, Status, Subject, read_result
from posetrack_cli.results.export.source import export_source
from support.results import CAMERA, RUN, make_estimate, with_fields

FRAMES, LOST = 6, 3
SUBJECT = Subject("head", "camera", (), POINT_NAMES, (-1,) * len(POINT_NAMES), lines=LINES)
IBUG = {36: "right_eye_outer", 45: "left_eye_outer", 48: "right_mouth_corner", 32: "right_nostril"}
"""Some of the 68 points of iBUG 300-W, which OpenFace numbers from 0; right is the subject's."""
ANGLE_ERROR = 1e-12


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Result:
    path = tmp_path_factory.mktemp("result") / "r.mcap"
    with ResultWriter(path, SUBJECT, CAMERA, RUN) as writer:
        for index in range(FRAMES):
            turn = Rotation.from_rotvec([0.1 * index, -0.05, 0.02 * index]) * Rotation.from_quat(FACING)
            place = np.array([10.0 * index, -20.0, 700.0])
            writer.write(
                with_fields(
                    make_estimate(index, k=0, p=len(POINT_NAMES)),
                    status=Status.LOST if index == LOST else Status.TRACKING,
                    position=place,
                    quaternion=turn.as_quat(canonical=True),
                    points=turn.apply(np.array(FEATURES)) + place,
                )
            )
        writer.finish({})
    return read_result(path)


@pytest.fixture
def rows(result: Result) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO("".join(openface_text(export_source(result))))))


def values(row: dict[str, str], *names: str) -> np.ndarray:
    return np.array([float(row[name]) for name in names])


def test_frames_and_success_are_counted_as_openface_does(rows: list[dict[str, str]], result: Result) -> None:
    pose = [f"pose_{kind}{axis}" for kind in "TR" for axis in "xyz"]
    assert list(rows[0])[:11] == ["frame", "face_id", "timestamp", "confidence", "success", *pose]
    assert [row["frame"] for row in rows] == [str(k + 1) for k in range(FRAMES)]
    assert [row["success"] for row in rows] == ["0" if k == LOST else "1" for k in range(FRAMES)]
    stamps = result.to_numpy()["stamp_ns"]
    np.testing.assert_allclose([float(row["timestamp"]) for row in rows], (stamps - stamps[0]) * 1e-9)
    lost = rows[LOST]
    assert {cell for name, cell in lost.items() if name[:4] == "pose" or name[1] == "_"} == {""}


def test_landmarks_are_numbered_as_in_ibug_and_seen_by_the_camera(
    rows: list[dict[str, str]], result: Result
) -> None:
    arrays = result.to_numpy()
    for k, row in enumerate(rows):
        if k == LOST:
            continue
        for index, name in IBUG.items():
            point = arrays["points"][k, POINT_NAMES.index(name)]
            np.testing.assert_array_equal(values(row, f"X_{index}", f"Y_{index}", f"Z_{index}"), point)
            distortion = np.array(CAMERA.distortion)
            seen, _ = cv2.projectPoints(point[None], np.zeros(3), np.zeros(3), CAMERA.matrix, distortion)
            np.testing.assert_allclose(values(row, f"x_{index}", f"y_{index}"), seen[0, 0], atol=1e-6)
    assert sum(name.startswith("x_") for name in rows[0]) == len(POINT_NAMES)


@pytest.mark.parametrize("angles", [(0.0, 0.0, 0.0), (0.3, -0.2, 0.1), (-0.5, 0.8, -1.2), (1.0, -1.4, 2.0)])
def test_the_rotation_of_openface_turns_its_model_like_ours(angles: tuple[float, float, float]) -> None:
    """OpenFace: R = Rx Ry Rz turns a face model with x to the image's right, y down, z into the head."""
    of_model = Rotation.from_euler("XYZ", angles)  # intrinsic, i.e. Rx Ry Rz
    ours = of_model * Rotation.from_matrix(
        np.diag([1.0, -1.0, -1.0])
    )  # from our axes: y up, z out of the face
    np.testing.assert_allclose(euler_xyz(ours.as_quat()[None])[0], angles, rtol=0, atol=ANGLE_ERROR)


@pytest.mark.parametrize(
    ("axis", "direction", "moved"),
    [
        (0, (0.0, 0.0, 1.0), (0.0, 1.0)),  # Rx > 0: the face (our z) goes down in the image
        (1, (0.0, 0.0, 1.0), (-1.0, 0.0)),  # Ry > 0: it goes to the image's left, the subject's right
        (2, (1.0, 0.0, 0.0), (0.0, 1.0)),  # Rz > 0: the subject's left (our x) goes down
    ],
)
def test_positive_angles_mean_what_openfaces_do(
    axis: int, direction: tuple[float, ...], moved: tuple[float, float]
) -> None:
    turn = Rotation.from_rotvec(0.2 * np.eye(3)[axis]) * Rotation.from_quat(FACING)
    angles = euler_xyz(turn.as_quat()[None])[0]
    assert angles[axis] == pytest.approx(0.2) and np.abs(np.delete(angles, axis)).max() < ANGLE_ERROR
    change = turn.apply(direction) - Rotation.from_quat(FACING).apply(direction)
    assert change[:2] @ moved > 0.15
