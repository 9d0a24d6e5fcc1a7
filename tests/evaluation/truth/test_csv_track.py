"""Truth from CSV: every column means what it says, and every fault is named with its line and column."""

from __future__ import annotations

import random
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from posetrack_cli.arrays import FloatArray
from posetrack_cli.errors import TruthError
from posetrack_cli.evaluation.reading.tracks import Track
from posetrack_cli.evaluation.reading.truth_tables import BLOCK_ROWS, load_csv_track
from posetrack_cli.results.estimate import Status, Subject
from posetrack_cli.results.export.export import export_file
from posetrack_cli.results.export.source import ExportSource
from posetrack_cli.results.reader import read_result
from support.truth import (
    FRAME_NS,
    HAND,
    HEAD,
    estimates,
    point_columns,
    pose_columns,
    write_csv,
    write_result,
)

HEAD_POINTS = tuple(
    f"{side}_{part}"
    for part in ("eye_outer", "eye_inner", "mouth_corner", "nostril", "brow_inner")
    for side in ("right", "left")
)
POSE_HEADER = "t_s,x_mm,y_mm,z_mm,qx,qy,qz,qw"
NOW_NS = 1763740800123456789
WRITTEN = 1e-12
"""Python writes floats so that they read back as they are; only the quaternions' length is made 1 anew."""


def of(array: Any) -> FloatArray:
    assert array is not None
    return np.asarray(array)


def load(tmp_path: Path, text: str | bytes, subject: Subject = HEAD) -> Track:
    path = tmp_path / "truth.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return load_csv_track(path, subject)


def message(tmp_path: Path, text: str | bytes, subject: Subject = HEAD) -> str:
    with pytest.raises(TruthError) as caught:
        load(tmp_path, text, subject)
    assert "\n" not in str(caught.value)
    return str(caught.value).replace(str(tmp_path / "truth.csv"), "F")


def test_poses_joints_angles_and_velocities_of_a_hand(tmp_path: Path) -> None:
    own = estimates(HAND, 5)
    shape, twist = np.array([e.shape for e in own]), np.array([of(e.twist) for e in own])
    columns = pose_columns(own) | point_columns(HAND, np.array([e.points for e in own]))
    columns |= {f"{name}_rad": shape[:, i] for i, name in enumerate(HAND.shape_names)}
    velocities = [f"v{a}_mm_s" for a in "xyz"] + [f"w{a}_rad_s" for a in "xyz"]
    velocities += [f"{name}_rad_s" for name in HAND.shape_names]
    columns |= {name: twist[:, i] for i, name in enumerate(velocities)}
    shuffled = dict(random.Random(1).sample(sorted(columns.items()), len(columns)))
    track = load_csv_track(write_csv(tmp_path / "t.csv", shuffled), HAND)
    assert (track.name, track.subject, track.lost) == ("t.csv", "hand", None)
    assert (track.shape_names, track.point_names) == (HAND.shape_names, HAND.point_names)
    assert track.point_parents == HAND.point_parents
    assert track.stamp_ns.tolist() == [e.stamp_ns for e in own]
    for name in ("position", "shape", "points", "twist"):
        np.testing.assert_array_equal(of(getattr(track, name)), [getattr(e, name) for e in own])
    np.testing.assert_allclose(of(track.quaternion), [e.quaternion for e in own], atol=WRITTEN)


def test_points_of_a_head_go_from_its_frame_to_the_camera(tmp_path: Path) -> None:
    own = estimates(HEAD, 6)
    in_head = np.array([Rotation.from_quat(e.quaternion).inv().apply(e.points - e.position) for e in own])
    columns = pose_columns(own) | point_columns(HEAD, in_head)
    track = load_csv_track(write_csv(tmp_path / "t.csv", columns), HEAD)
    np.testing.assert_allclose(of(track.points), [e.points for e in own], atol=1e-9)
    assert track.shape is None and track.shape_names == ()


def test_joints_alone_are_a_truth(tmp_path: Path) -> None:
    own = estimates(HAND, 3)
    stamps = {"time_s": [0.0, 0.5, 1.0]}
    columns = stamps | point_columns(HAND, np.array([e.points for e in own])) | {"note": [1.0, 2.0, 3.0]}
    track = load_csv_track(write_csv(tmp_path / "t.csv", columns), HAND)
    assert track.stamp_ns.tolist() == [0, 500_000_000, 1_000_000_000]
    assert (track.position, track.quaternion, track.shape, track.twist) == (None,) * 4
    np.testing.assert_array_equal(of(track.points), [e.points for e in own])


def test_further_points_of_other_names_are_ignored(tmp_path: Path) -> None:
    own = estimates(HEAD, 2)
    more = Subject("head", "camera", (), ("ear", *HEAD.point_names), (-1,) * 4)
    points = np.random.default_rng(0).standard_normal((2, 4, 3))
    columns = pose_columns(own) | point_columns(more, points)
    assert load_csv_track(write_csv(tmp_path / "t.csv", columns), HEAD).point_names == HEAD.point_names


@pytest.mark.parametrize(
    ("header", "cells", "expected"),
    [
        (
            "stamp_ns",
            ["1763740800123456789", "1763740800123456790"],
            [1763740800123456789, 1763740800123456790],
        ),
        ("stamp_ns", ["5.0", "1e3"], [5, 1000]),
        (
            "t_s",
            ["1763740800.123456789", "1763740800.1234567896"],
            [1763740800123456789, 1763740800123456790],
        ),
        ("time_s", [" -0.0333333334 ", "0"], [-33333333, 0]),
    ],
)
def test_stamps_keep_their_nanoseconds(
    tmp_path: Path, header: str, cells: list[str], expected: list[int]
) -> None:
    text = f"{header},x_mm,y_mm,z_mm\n" + "".join(f"{cell},1,2,3\n" for cell in cells)
    assert load(tmp_path, text).stamp_ns.tolist() == expected


@pytest.mark.parametrize("format_name", ["csv", "json"])
@pytest.mark.parametrize("subject", [HAND, HEAD], ids=["hand", "head"])
def test_an_exported_result_is_a_truth(tmp_path: Path, subject: Subject, format_name: str) -> None:
    """All but its lost frames; a rotation of the points to and from a head's axes rounds."""
    own = estimates(subject, 9, lost=(2, 3))
    result = read_result(write_result(tmp_path / "r.mcap", subject, own))
    export_file(ExportSource(result, result.estimate_topic), format_name, tmp_path / f"r.{format_name}")
    track = load_csv_track(tmp_path / f"r.{format_name}", subject)
    kept = [one for one in own if one.status != Status.LOST]
    assert (track.name, track.shape_names) == (
        f"r.{format_name} without its 2 lost frames",
        subject.shape_names,
    )
    assert track.stamp_ns.tolist() == [one.stamp_ns for one in kept]
    for name in ("position", "quaternion", "shape", "twist", "points"):
        expected = [getattr(one, name) for one in kept]
        np.testing.assert_allclose(of(getattr(track, name)), expected, rtol=1e-12, atol=1e-9)


def test_a_trajectory_in_tum_s_format_is_a_truth(tmp_path: Path) -> None:
    """Metres become mm, by decimals; other programs write no comments, and more spaces."""
    own = estimates(HEAD, 9)
    result = read_result(write_result(tmp_path / "r.mcap", HEAD, own))
    export_file(ExportSource(result, result.estimate_topic), "tum", tmp_path / "r.tum")
    track = load_csv_track(tmp_path / "r.tum", HEAD)
    assert track.stamp_ns.tolist() == [one.stamp_ns for one in own]
    np.testing.assert_allclose(of(track.position), [one.position for one in own], rtol=1e-12)
    np.testing.assert_allclose(of(track.quaternion), [one.quaternion for one in own], atol=WRITTEN)
    track = load(tmp_path, "1.5   0.001 0.002 -0.7  0 0 0 1\n")
    assert (track.stamp_ns.tolist(), of(track.position).tolist()) == ([1_500_000_000], [[1, 2, -700]])
    assert "line 2: row does not fit the header, found 7" in message(
        tmp_path, "1 0 0 0 0 0 0 1\n2 0 0 0 0 0 1\n"
    )
    assert "line 2, column x_mm: is not a number" in message(tmp_path, "1 0 0 0 0 0 0 1\n2 x 0 0 0 0 0 1\n")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[1, 2]", "no table in the JSON file, found list"),
        ('{"rows": []}', "no table in the JSON file, found rows"),
        ('{"columns": {"t_s": [1, 2], "x_mm": [1]}}', "columns differ in length"),
        ("{", "is not valid JSON"),
        ("[" * 100_000, "is not valid JSON"),
    ],
)
def test_json_that_is_no_export(tmp_path: Path, text: str, says: str) -> None:
    path = tmp_path / "truth.json"
    path.write_text(text)
    with pytest.raises(TruthError, match=says):
        load_csv_track(path, HEAD)


def test_a_file_of_lost_frames_has_no_truth(tmp_path: Path) -> None:
    text = "stamp_ns,status,x_mm,y_mm,z_mm\n1,lost,1,2,3\n2,lost,1,2,3\n"
    assert message(tmp_path, text) == "F: no ground truth, found 2 rows, all lost, expected a row per frame"


def test_integer_stamps_come_before_seconds(tmp_path: Path) -> None:
    assert load(tmp_path, "t_s,stamp_ns,x_mm,y_mm,z_mm\n1,7,0,0,0\n").stamp_ns.tolist() == [7]


def test_comments_blank_lines_quotes_and_a_byte_order_mark(tmp_path: Path) -> None:
    text = '\ufeff# a comment\n\nt_s,"x_mm", y_mm ,z_mm\r\n# between\n0,"1",2,3\n\n0.5,4,5, 6\n#end'
    track = load(tmp_path, text)
    np.testing.assert_array_equal(of(track.position), [[1, 2, 3], [4, 5, 6]])


def test_quaternions_are_made_unit_with_w_positive(tmp_path: Path) -> None:
    track = load(tmp_path, f"{POSE_HEADER}\n0,0,0,0,0.6,0,0,-0.8004\n1,0,0,0,1,0,0,0\n")
    expected = np.array([-0.6, 0.0, 0.0, 0.8004]) / np.hypot(0.6, 0.8004)
    np.testing.assert_allclose(of(track.quaternion), [expected, [1, 0, 0, 0]], atol=WRITTEN)


def test_a_velocity_may_be_unknown_here_and_there(tmp_path: Path) -> None:
    text = "t_s,vx_mm_s,vy_mm_s,vz_mm_s\n0,1,2,3\n1,,,\n2,nan,NaN, \n"
    twist = of(load(tmp_path, text).twist)
    assert twist.shape == (3, 6)
    np.testing.assert_array_equal(twist[0], [1, 2, 3, np.nan, np.nan, np.nan])
    assert np.isnan(twist[1:]).all()


def test_a_velocity_that_is_unknown_everywhere_is_none(tmp_path: Path) -> None:
    assert load(tmp_path, "t_s,x_mm,y_mm,z_mm,wx_rad_s,wy_rad_s,wz_rad_s\n0,1,2,3,,,\n").twist is None


GOOD = f"{POSE_HEADER}\n0,1,2,3,0,0,0,1\n0.5,1,2,3,0,0,0,1\n"
ONE_POINT = "t_s,{0}_x_mm,{0}_y_mm,{0}_z_mm\n0,1,2,3\n"
T = " line 4, column t_s"
Q = " line 4, columns qx qy qz qw: quaternion is not normalised"
OTHER = ": ground truth has other points than the result, found"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", ": is empty, expected a CSV file with a header row"),
        ("# only\n\n", ": is empty"),
        ("stamp_ns;x_mm;y_mm;z_mm\n0;1,5;2;3\n", ": columns are not separated by commas, found semicolons"),
        ("t_s\tx_mm\ty_mm\tz_mm\n0\t1\t2\t3\n", ": columns are not separated by commas, found tabs"),
        ("t_s x_mm y_mm z_mm\n0 1 2 3\n", ": columns are not separated by commas, found spaces"),
        ("fx = 363.9\n", ": no known column, found fx = 363.9"),
        (
            "t_s,x_mm,y_mm,z_mm\r0,1,2,3\r",
            " line 1: is not valid CSV, found a bare carriage return; end lines",
        ),
        (f"{POSE_HEADER}\n", ": no ground truth, found no row after the header, expected a row per frame"),
        (GOOD + "0.6,1,2,3,0,0,0\n", " line 4: row does not fit the header, found 7 cells, expected 8"),
        (GOOD + "0.6,1,2,3,0,0,0,1,\n", " line 4: row does not fit the header, found 9 cells"),
        (GOOD + "# c\n0.6,1,two,3,0,0,0,1\n", " line 5, column y_mm: is not a number, found 'two'"),
        (GOOD + "0.6,1,,3,0,0,0,1\n", " line 4, column y_mm: is not a number, found ''"),
        (GOOD + "0.6,1,2,nan,0,0,0,1\n", " line 4, column z_mm: is not finite, found 'nan'"),
        (GOOD + "0.6,1e999,2,3,0,0,0,1\n", " line 4, column x_mm: is not finite, found '1e999'"),
        (GOOD + "0.6,1,2,3,0,0,0,0\n", f"{Q}, found length 0, expected 1"),
        (GOOD + "0.6,1,2,3,0,0,0,1.01\n", f"{Q}, found length 1.01"),
        (GOOD + "0.5,1,2,3,0,0,0,1\n", f"{T}: duplicate stamp, found 500000000 ns after 500000000 ns"),
        (GOOD + "0.4,1,2,3,0,0,0,1\n", f"{T}: stamps are not sorted, found 400000000 ns after 5"),
        (GOOD + "now,1,2,3,0,0,0,1\n", f"{T}: stamp is not a number, found 'now'"),
        (GOOD + "nan,1,2,3,0,0,0,1\n", f"{T}: stamp is not a number, found 'nan'"),
        (GOOD + "1e99999,1,2,3,0,0,0,1\n", f"{T}: stamp is out of range, found '1e99999'"),
        ("stamp_ns,x_mm,y_mm,z_mm\n1.5,1,2,3\n", " line 2, column stamp_ns: stamp is not a whole number"),
        ("t_s,x_mm,z_mm\n0,1,2\n", ": missing columns y_mm, expected all or none of x_mm, y_mm, z_mm"),
        ("t_s,qx,qy,qz,qW\n0,0,0,0,1\n", ": missing columns qw, expected all or none of qx, qy, qz"),
        ("t_s,vx_mm_s\n0,1\n", ": missing columns vy_mm_s, vz_mm_s, expected all"),
        ("t_s,x_mm,x_mm,y_mm,z_mm\n0,1,1,2,3\n", ": column occurs twice, found x_mm"),
        ("x_mm,y_mm,z_mm\n1,2,3\n", ": no stamp column, expected stamp_ns or t_s or time_s"),
        ("time,x,y,z\n0,1,2,3\n", ": no known column, found time, x, y, z, expected stamp_ns/t_s"),
        (ONE_POINT.format("eye"), f"{OTHER} 1 points, expected also nose, mouth"),
        (ONE_POINT.format("brow"), f"{OTHER} brow, expected also eye, nose, mouth"),
        (b"t_s,x_mm,y_mm,z_mm\n0,1,2,3\n0.5,\xe4,2,3\n", " line 3: is not UTF-8 text, found byte 0xe4"),
    ],
)
def test_every_fault_is_named(tmp_path: Path, text: str | bytes, expected: str) -> None:
    assert message(tmp_path, text).startswith(f"F{expected}")


def test_every_known_column_is_listed_and_few_of_the_file_s(tmp_path: Path) -> None:
    listed = message(tmp_path, ",".join(f"column {i}" for i in range(1000)), HAND)
    found, known = listed.split(", expected ")
    assert len(found) < 150 and found.endswith("...")
    names = ("stamp_ns", "t_s", "qw", "vx_mm_s", "wz_rad_s", "<point>_x_mm", "<name>_rad_s")
    assert all(name in known for name in (*names, *HAND.point_names, *HAND.shape_names))


def test_points_of_a_head_need_its_pose(tmp_path: Path) -> None:
    columns = ",".join(f"{name}_{axis}_mm" for name in HEAD.point_names for axis in "xyz")
    assert message(tmp_path, f"t_s,{columns}\n0,1,2,3,4,5,6,7,8,9\n") == (
        "F: points of a head are in its model frame and require the pose, "
        "expected columns x_mm, y_mm, z_mm, qx, qy, qz, qw"
    )


def test_one_axis_of_a_point_is_not_enough(tmp_path: Path) -> None:
    columns = ",".join(f"{name}_{axis}_mm" for name in HEAD.point_names for axis in "xyz")
    text = f"{POSE_HEADER},{columns.removesuffix(',mouth_z_mm')}\n0,1,2,3,0,0,0,1,1,2,3,4,5,6,7,8\n"
    assert message(tmp_path, text).startswith("F: missing columns mouth_z_mm, expected")


@pytest.mark.parametrize("line", [2, BLOCK_ROWS, BLOCK_ROWS + 1, BLOCK_ROWS + 2, 2 * BLOCK_ROWS + 7])
def test_faults_in_long_files_keep_their_line(tmp_path: Path, line: int) -> None:
    rows = [f"{i},1,2,3" for i in range(2 * BLOCK_ROWS + 10)]
    rows[line - 2] = f"{line - 2},1,x,3"
    text = "stamp_ns,x_mm,y_mm,z_mm\n" + "\n".join(rows)
    assert message(tmp_path, text) == f"F line {line}, column y_mm: is not a number, found 'x'"


@settings(deadline=None)
@given(st.lists(st.floats(-1e6, 1e6), min_size=3, max_size=30))
def test_numbers_read_back_as_they_were_written(
    tmp_path_factory: pytest.TempPathFactory, x: list[float]
) -> None:
    columns = {"stamp_ns": np.arange(len(x)), "x_mm": x, "y_mm": x[::-1], "z_mm": x}
    path = write_csv(tmp_path_factory.mktemp("csv") / "t.csv", columns)
    track = load_csv_track(path, HEAD)
    np.testing.assert_array_equal(of(track.position), np.stack([x, x[::-1], x], axis=1))


def test_a_path_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(TruthError, match="cannot be read, found No such file"):
        load_csv_track(tmp_path / "none.csv", HEAD)


def test_unicode_in_names_and_comments(tmp_path: Path) -> None:
    text = "# größe: mm\nt_s,x_mm,y_mm,z_mm,приме́чание\n0,1,2,3,да\n"
    assert of(load(tmp_path, text).position).tolist() == [[1.0, 2.0, 3.0]]


@pytest.mark.parametrize(("person", "frames"), [("person-a", 600), ("person-b", 300)])
def test_truth_of_the_rendered_heads(measured_data: Path, person: str, frames: int) -> None:
    """Against numpy.genfromtxt and scipy; the file has five decimals."""
    path = measured_data / "heads" / person / "truth.csv"
    track = load_csv_track(path, Subject("head", "camera", (), HEAD_POINTS, (-1,) * 10))
    raw = np.genfromtxt(path, delimiter=",", names=True)
    assert len(track) == frames
    np.testing.assert_allclose(track.stamp_ns * 1e-9, raw["t_s"], atol=1e-9)
    poses = Rotation.from_quat(np.stack([raw[f"q{axis}"] for axis in "xyzw"], axis=1))
    position = np.stack([raw[f"{axis}_mm"] for axis in "xyz"], axis=1)
    np.testing.assert_array_equal(of(track.position), position)
    for column, name in enumerate(HEAD_POINTS):
        own = np.stack([raw[f"{name}_{axis}_mm"] for axis in "xyz"], axis=1)
        np.testing.assert_allclose(of(track.points)[:, column], poses.apply(own) + position, atol=1e-9)
    assert (
        FRAME_NS - 10_000 < np.diff(track.stamp_ns).min() <= np.diff(track.stamp_ns).max() < FRAME_NS + 10_000
    )
