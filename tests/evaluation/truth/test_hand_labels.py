"""Annotations of public datasets, written by own code in each layout: order, unit, axes, hostile pickles."""

from __future__ import annotations

import os
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from posetrack_cli.arrays import FloatArray
from posetrack_cli.cli.main import run
from posetrack_cli.errors import TruthError
from posetrack_cli.evaluation.measuring.evaluate import EvalOptions, evaluate
from posetrack_cli.evaluation.reading.hand_labels import is_labels, read_labels
from posetrack_cli.evaluation.reading.pickled import read_pickled
from posetrack_cli.evaluation.reading.truth import load_truth
from posetrack_cli.hand.model.anatomy import JOINT_NAMES
from posetrack_cli.results.reader import read_result
from support.truth import HAND, estimates, write_result

FRAMES = 4
MM = 1e-3
"""Files have six digits after the point, or float32 at half a metre."""
OURS = {"T": "thumb", "I": "index", "M": "middle", "R": "ring", "P": "little"}
STEPS = {"MCP": ("cmc", "mcp"), "PIP": ("mcp", "pip"), "DIP": ("ip", "dip"), "TIP": ("tip", "tip")}


def ours(name: str) -> str:
    """Our name of a joint that the HANDS challenges name like TMCP."""
    return "wrist" if name == "Wrist" else f"{OURS[name[0]]}_{STEPS[name[1:]][name[0] != 'T']}"


def fingers(order: str, steps: str = "MCP PIP DIP TIP") -> list[str]:
    return [finger + step for finger in order for step in steps.split()]


HANDS = ["Wrist", *(f"{f}MCP" for f in "TIMRP"), *fingers("TIMRP", "PIP DIP TIP")]
MSRA = ["Wrist", *fingers("IMRPT")]
DEXYCB = ["Wrist", *fingers("TIMRP")]
HO3D = ["Wrist", *fingers("IMPRT", "MCP PIP DIP"), *(f"{f}TIP" for f in "TIMRP")]
ICVL = ["Palm", "TPIP", "TDIP", "TTIP", *fingers("IMRP", "PIP DIP TIP")]
# Ends of NYU's bones: F1 is the little finger, A the far end.
NYU_ENDS = {"KNU3_A": "TIP", "KNU3_B": "DIP", "KNU2_B": "PIP", "KNU1_B": "MCP"}
NYU = [f"{f}_KNU{k}_{end}" for f in ("F1", "F2", "F3", "F4", "TH") for k in (3, 2, 1) for end in "AB"]
NYU += [f"PALM_{k}" for k in range(1, 7)]
NYU_FINGERS = {"F1": "P", "F2": "R", "F3": "M", "F4": "I", "TH": "T"}


def truth() -> FloatArray:
    """Joints (N, 21, 3) in our order, mm, camera axes; all numbers differ."""
    return np.random.default_rng(3).uniform(-90.0, 90.0, (FRAMES, 21, 3)) + np.array([30.0, -40.0, 500.0])


def of(names: list[str], frame: FloatArray) -> FloatArray:
    """Joints in the order of the names; others are far off."""
    known = {name: ours(name) for name in names if name == "Wrist" or name[1:] in STEPS}
    return np.array([frame[JOINT_NAMES.index(known[n])] if n in known else [1e3, 1e3, 2e3] for n in names])


def nyu_points(frame: FloatArray) -> FloatArray:
    points = np.full((36, 3), 3e3)
    for k, name in enumerate(NYU):
        finger, _, end = name.partition("_")
        if end in NYU_ENDS:
            points[k] = of([NYU_FINGERS[finger] + NYU_ENDS[end]], frame)[0]
    wrist = of(["Wrist"], frame)[0]
    side = np.array([20.0, 1.0, -3.0])
    points[30], points[31] = wrist + side, wrist - side
    return points * [1.0, -1.0, 1.0]


def text(path: Path, rows: list[str]) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(rows) + "\n")
    return path


def cells(points: FloatArray) -> str:
    return " ".join(f"{v:.6f}" for v in points.ravel())


def write_nyu(folder: Path) -> Path:
    from scipy.io import savemat

    values = np.array([[nyu_points(frame) for frame in truth()]] * 3)
    values[1:] += 7.0  # the other cameras
    folder.mkdir()
    savemat(folder / "joint_data.mat", {"joint_xyz": values, "joint_uvd": values}, do_compression=True)
    return folder


def write_msra(folder: Path) -> Path:
    rows = [cells(of(MSRA, frame) * [1.0, -1.0, -1.0]) for frame in truth()]
    return text(folder / "joint.txt", [str(FRAMES), *rows]).parent


def write_icvl(folder: Path) -> Path:
    rows = []
    for k, frame in enumerate(truth()):
        x, y, z = of(ICVL, frame).T
        pixels = np.stack([241.42 * x / z + 160.0, 241.42 * y / z + 120.0, z], axis=1)
        rows += [
            f"test_seq_1/image_{k:04d}.png {cells(pixels)} ",
            f"test_seq_2/image_{k:04d}.png {cells(-pixels)}",
        ]
    return text(folder / "labels.txt", rows)


def write_hands(folder: Path) -> Path:
    name = "image_D{:08d}.png\t"
    rows = [name.format(k + 1) + cells(of(HANDS, f)).replace(" ", "\t") for k, f in enumerate(truth())]
    return text(folder / "Training_Annotation.txt", rows)


def write_fhad(folder: Path) -> Path:
    return text(folder / "skeleton.txt", [f"{k:d} {cells(of(HANDS, f))}" for k, f in enumerate(truth())])


def write_dexycb(folder: Path) -> Path:
    camera = folder / "932122060857"
    camera.mkdir(parents=True)
    (folder / "meta.yml").write_text("serials:\n- '932122060857'\nmano_sides:\n- left\nnum_frames: 5\n")
    for k, frame in enumerate([*truth(), None]):  # type: ignore[list-item]  # the last one has no hand
        joints = np.full((1, 21, 3), -1.0) if frame is None else of(DEXYCB, frame)[None] / 1e3
        np.savez_compressed(
            camera / f"labels_{k:06d}.npz", joint_3d=joints.astype(np.float32), seg=np.zeros((4, 6), np.uint8)
        )
    return camera


def write_ho3d(folder: Path, protocol: int = 2) -> Path:
    (folder / "meta").mkdir(parents=True)
    for k, frame in enumerate([*truth(), None]):  # type: ignore[list-item]
        joints = None if frame is None else of(HO3D, frame) * [1.0, -1.0, -1.0] / 1e3
        meta = {
            "handJoints3D": joints,
            "camMat": np.eye(3),
            "objName": "003_cracker_box",
            "objLabel": np.int64(2),
        }
        (folder / "meta" / f"{k:04d}.pkl").write_bytes(pickle.dumps(meta, protocol))
    return folder


LAYOUTS: dict[str, Callable[[Path], Path]] = {
    "NYU": write_nyu,
    "MSRA": write_msra,
    "ICVL": write_icvl,
    "HANDS 2017": write_hands,
    "FHAD": write_fhad,
    "DexYCB": write_dexycb,
    "HO-3D": write_ho3d,
}
RECORDING = "test_seq_1"


@pytest.mark.parametrize("name", LAYOUTS)
def test_each_layout_gives_our_joints_in_camera_axes(tmp_path: Path, name: str) -> None:
    path = LAYOUTS[name](tmp_path / "data")
    assert is_labels(path)
    labels = read_labels(path, RECORDING)
    assert labels.name.startswith(name) and labels.frames.tolist() == list(range(FRAMES))
    track = labels.track(path, labels.frames, labels.frames)
    columns = [JOINT_NAMES.index(joint) for joint in track.point_names]
    assert len(columns) == (15 if name == "ICVL" else 21)
    np.testing.assert_allclose(track.points, truth()[:, columns], atol=MM)
    assert ("left hand" in track.name) == (name == "DexYCB")
    mirrored = labels.track(path, labels.frames, labels.frames, mirrored=True).points
    np.testing.assert_allclose(mirrored, truth()[:, columns] * [-1.0, 1.0, 1.0], atol=MM)


@pytest.mark.parametrize("name", ["ICVL", "NYU"])
def test_eval_measures_the_annotated_joints(tmp_path: Path, name: str) -> None:
    """Means of distances, computed here; annotations of frames are found by number at any rate."""
    path = LAYOUTS[name](tmp_path / "data")
    result = write_result(tmp_path / "r.mcap", HAND, estimates(HAND, FRAMES))
    if name == "ICVL":  # one recording's rows
        path.write_text("\n".join(row for row in path.read_text().splitlines() if row.startswith(RECORDING)))
    got = evaluate(result, EvalOptions(truth=path))
    joints = [JOINT_NAMES[0]] * (name == "NYU") + [
        j for j in JOINT_NAMES[1:] if name == "NYU" or ours_of_icvl(j)
    ]
    own = np.array([one.points for one in estimates(HAND, FRAMES)])
    columns = [JOINT_NAMES.index(joint) for joint in joints]
    errors = np.linalg.norm(own - truth(), axis=2)[:, columns]
    assert got.metrics["matched"] == FRAMES
    assert got.metrics["joint_error_mm"].mean == pytest.approx(errors.mean(), rel=1e-4)
    assert got.metrics["joint_error_mm.index_tip"].mean == pytest.approx(
        errors[:, joints.index("index_tip")].mean(), rel=1e-4
    )
    command = ["eval", str(result), "--truth", str(path), "--html", str(tmp_path / "r.html"), "--mcap"]
    assert run([*command, str(tmp_path / "e.mcap")]) == 0


def ours_of_icvl(joint: str) -> bool:
    return not joint.endswith(("wrist", "cmc", "mcp")) or joint == "thumb_mcp"


def test_rows_of_several_folders_need_the_recording(tmp_path: Path) -> None:
    with pytest.raises(TruthError, match="labels of several folders, found test_seq_1, test_seq_2"):
        read_labels(write_icvl(tmp_path), "other")


@pytest.mark.parametrize("protocol", [0, 1, 2, 4])
def test_pickles_of_protocols_to_4(tmp_path: Path, protocol: int) -> None:
    labels = read_labels(write_ho3d(tmp_path / "data", protocol), "")
    track = labels.track(tmp_path, labels.frames, labels.frames)
    np.testing.assert_allclose(track.points, truth(), atol=1e-9)


def test_python_2_pickles() -> None:
    """Strings of Python 2 are bytes in Latin-1, and numpy's data is such a string."""
    data = b"cnumpy.core.multiarray\n_reconstruct\n(cnumpy\nndarray\n(I0\ntS'b'\ntR(I1\n(I1\nI2\nt"
    data += b"cnumpy\ndtype\n"
    data += b"(S'f4'\nI0\nI1\ntR(I3\nS'<'\nNNNI-1\nI-1\nI0\ntbI00\nS'\\x00\\x00\\x80?\\x00\\x00\\x00@'\ntb."
    from posetrack_cli.evaluation.reading.pickled import array_of

    np.testing.assert_array_equal(array_of(read_pickled(data)), [[1.0, 2.0]])


class Attack:
    """Calls what it is given when unpickled."""

    def __init__(self, call: Callable[..., Any], *args: Any) -> None:
        self.given = call, args

    def __reduce__(self) -> Any:
        return self.given


def nested(depth: int) -> bytes:
    """A dict whose key is a tuple in a tuple in a tuple: hashing it takes the whole stack."""
    return b"\x80\x02})" + b"\x85" * depth + b"Ns."


def large_array() -> bytes:
    return pickle.dumps({"handJoints3D": np.zeros(63)}, 2).replace(b"K?\x85", b"J\xff\xff\xff\x7f\x85")


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (pickle.dumps(Attack(os.system, "touch attacked")), "pickle refers to 'posix system'"),
        (pickle.dumps(Attack(eval, "1"), 0), "pickle refers to '__builtin__ eval'"),
        (pickle.dumps(Attack(np.load, "x")), "pickle refers to 'numpy load'"),
        (
            pickle.dumps({"handJoints3D": np.array([Attack(os.getcwd)], object)}),
            "pickle refers to 'posix getcwd'",
        ),
        (pickle.dumps({"handJoints3D": np.array([None] * 63, object)}), "not numeric"),
        (b"Pattack\n.", "opcode PERSID"),
        (b"\x80\x02\x82\x01.", "opcode EXT1"),
        (nested(900_000), "key that is not text"),
        (large_array(), "cannot reshape"),
        (pickle.dumps({"handJoints3D": np.zeros((21, 3))})[:-40], "no annotated joints"),
        (pickle.dumps({"handJoints3D": np.zeros((20, 3))}), r"\(20, 3\) in place of 21 joints of HO-3D"),
        (pickle.dumps({"other": 1}), "no array"),
        (b"\x80\x02]q\x00h\x00ba.", "damaged pickle"),
        (b"", "pickle ends early"),
    ],
)
def test_hostile_pickles_are_one_line(tmp_path: Path, data: bytes, says: str) -> None:
    folder = write_ho3d(tmp_path / "data")
    (folder / "meta" / "0002.pkl").write_bytes(data)
    with pytest.raises(TruthError, match=says) as caught:
        read_labels(folder, "")
    assert "0002.pkl" in str(caught.value) and "\n" not in str(caught.value)
    assert not Path("attacked").exists()


@pytest.mark.parametrize(
    ("name", "file", "content", "says"),
    [
        ("MSRA", "joint.txt", b"2\n" + b"1 " * 63 + b"\n1 2\n", "line 3"),
        ("FHAD", "skeleton.txt", b"1 " * 64 + b"\n" + b"1 " * 64, "two rows of one frame"),
        ("FHAD", "skeleton.txt", b"1 " * 63 + b"x", "numbers"),
        ("NYU", "joint_data.mat", b"MATLAB 5.0" + b"\0" * 200, "damaged MATLAB file"),
        ("DexYCB", "labels_000001.npz", b"PK\x03\x04", "no annotated joints"),
    ],
)
def test_damage_is_one_line_with_its_place(
    tmp_path: Path, name: str, file: str, content: bytes, says: str
) -> None:
    path = LAYOUTS[name](tmp_path / "data")
    folder = path if path.is_dir() else path.parent
    (folder / file).write_bytes(content)
    with pytest.raises(TruthError, match=says) as caught:
        read_labels(path, "")
    assert file in str(caught.value) and "\n" not in str(caught.value)


def test_other_files_are_no_labels(tmp_path: Path) -> None:
    result = read_result(write_result(tmp_path / "r.mcap", HAND, estimates(HAND, FRAMES)))
    for path in (tmp_path, text(tmp_path / "a.txt", ["1 2 3"]), tmp_path / "missing.txt"):
        assert not is_labels(path)
        with pytest.raises(TruthError):
            load_truth(result, path)
