"""camera.toml of several cameras: what it says, what is wrong with it, what is written comes back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from posetrack_cli.errors import RecordingError
from posetrack_cli.geometry.camera import IN_PLACE, Camera
from posetrack_cli.geometry.rigid import placed
from posetrack_cli.recording.camera_file import camera_file_text, load_rig
from support import images as support

INTRINSICS = "fx = 40.0\nfy = 41.0\ncx = 15.0\ncy = 12.0\n"
PLACE = "rotation = [1, 0, 0, 0, 1, 0, 0, 0, 1]\ntranslation_mm = [-100, 0, 0]\n"
TWO = f"[cameras.left]\n{INTRINSICS}[cameras.right]\n{INTRINSICS}{PLACE}"
SIZES = {"left": (32, 24), "right": (32, 24), "": (32, 24)}


def load(tmp_path: Path, text: str):  # type: ignore[no-untyped-def]
    (tmp_path / "camera.toml").write_text(text)
    return load_rig(tmp_path / "camera.toml")


def cameras(tmp_path: Path, text: str) -> tuple[Camera, ...]:
    return load(tmp_path, text).stored_cameras(SIZES)  # type: ignore[no-any-return]


def test_what_is_written_is_read_back(tmp_path: Path) -> None:
    written = support.rig(['the "first"', 'a camera "x"\\', "third", "a\n[cameras.b]\x1b\x7f\u202e ü"])
    comments = ["measured", "", "by hand\nreference = 1"]
    (tmp_path / "camera.toml").write_text(camera_file_text(written, comments), encoding="utf-8")
    read = load_rig(tmp_path / "camera.toml").stored_cameras({c.name: (32, 24) for c in written})
    assert (tmp_path / "camera.toml").read_text().startswith("# measured\n#\n# by hand\\nreference = 1\n")
    for before, after in zip(written, read, strict=True):
        assert before.values() == after.values()
        np.testing.assert_allclose(after.camera_T_reference, before.camera_T_reference, atol=1e-12)


def test_the_first_camera_is_the_reference_unless_another_is_named(tmp_path: Path) -> None:
    left, right = cameras(tmp_path, TWO)
    assert (left.name, right.name) == ("left", "right")
    assert left.camera_T_reference == IN_PLACE
    np.testing.assert_allclose(np.array(right.camera_T_reference)[:, 3], [-100, 0, 0])


def test_places_are_made_relative_to_the_reference_that_is_named(tmp_path: Path) -> None:
    right, left = cameras(tmp_path, f'reference = "right"\n{TWO}')
    assert (right.name, left.name) == ("right", "left")
    assert right.camera_T_reference == IN_PLACE
    np.testing.assert_allclose(np.array(left.camera_T_reference)[:, 3], [100, 0, 0])


def test_one_camera_without_a_table(tmp_path: Path) -> None:
    (camera,) = cameras(tmp_path, INTRINSICS + "mirror = true\n")
    assert (camera.name, camera.fx) == ("camera", 40.0)
    assert load(tmp_path, INTRINSICS + "mirror = true\n").mirror


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (TWO.replace(PLACE, ""), "extrinsics of cameras left, right are missing"),
        (TWO.replace("translation_mm = [-100, 0, 0]\n", ""), "extrinsics of camera 'right' are incomplete"),
        (
            TWO.replace("rotation = [1,", "rotation = [2,"),
            "rotation of camera 'right': is not a rotation, found 2",
        ),
        (TWO.replace("rotation = [1,", "rotation = [-1,"), "is not a rotation"),
        (
            TWO.replace("[-100, 0, 0]", "[-0.1, 0, 0]"),
            "'left' and 'right' have no baseline, found 0.1 mm",
        ),
        (TWO.replace("rotation = [1, 0", "rotation = [1"), "invalid value for 'rotation'"),
        (TWO.replace("fx = 40.0\n", "fx = 0\n"), "[cameras.left]: invalid value for 'fx'"),
        (TWO.replace("fx = 40.0\n", ""), "key 'fx' is missing"),
        (TWO + "trnslation_mm = [1, 2, 3]\n", "unknown key 'trnslation_mm'; did you mean 'translation_mm'?"),
        ('refrence = "left"\n' + TWO, "unknown key 'refrence'; did you mean 'reference'?"),
        ('reference = "middle"\n' + TWO, "reference 'middle' is not a camera"),
        ("mirror = 3\n" + TWO, "invalid value for 'mirror'"),
        ("cameras = 3\n", "invalid 'cameras'"),
        (TWO.replace("fx = 40.0", "width = 30\nfx = 40.0"), "found images of 32x24, expected 30x24"),
        (INTRINSICS + "depht_unit_mm = 1.0\n", "unknown key 'depht_unit_mm'; did you mean 'depth_unit_mm'?"),
        ("x = [", "not valid TOML"),
    ],
)
def test_what_is_wrong_is_told_in_one_line(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(RecordingError) as caught:
        cameras(tmp_path, text)
    assert message in str(caught.value)
    assert "camera.toml" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_camera_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="no camera 'rigth'; did you mean 'right'"):
        load(tmp_path, TWO).subset(["rigth"])


def test_a_mirrored_rig_sees_the_mirrored_scene() -> None:
    point = np.array([30.0, -20.0, 600.0])
    for camera in support.rig():
        mirrored = camera.mirrored()
        for own, p in ((camera, point), (mirrored, point * [-1, 1, 1])):
            transform = np.array(own.camera_T_reference)
            pixel = own.pixels_from_points(transform[:, :3] @ p + transform[:, 3])[0]
            if own is camera:
                expected = [camera.width - 1 - pixel[0], pixel[1]]
        np.testing.assert_allclose(pixel, expected, atol=1e-9)


def test_placing_a_camera_writes_no_negative_zero() -> None:
    camera = placed(support.rig()[0], np.column_stack([np.eye(3), [-0.0, 0.0, 0.0]]))
    assert "-0.0" not in str(camera.camera_T_reference)


@pytest.mark.parametrize(
    "line",
    ["reference = []", "reference = {a = 1}", "reference = 3", "distortion = [1e308, 1e308, 1e308, 1e308]"],
)
def test_values_of_no_camera_are_one_error(tmp_path: Path, line: str) -> None:
    path = tmp_path / "rig.toml"
    lens = line if line.startswith("distortion") else ""
    top = "" if lens else line
    path.write_text(f"{top}\n[cameras.a]\nfx = 60.0\nfy = 60.0\ncx = 32.0\ncy = 24.0\n{lens}\n")
    with pytest.raises(RecordingError, match=r"^[^\n]+$"):
        load_rig(path)


def test_more_cameras_than_any_rig_has_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "rig.toml"
    path.write_text("".join(f"[cameras.c{k}]\n" for k in range(1001)))
    with pytest.raises(RecordingError, match="too many cameras, found 1001"):
        load_rig(path)
