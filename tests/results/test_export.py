"""Exported files, read by other readers and compared with the estimates themselves."""

from __future__ import annotations

import csv
import filecmp
import io
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from posetrack_cli.errors import ResultError, UsageError
from posetrack_cli.geometry.rotations import EULER_ORDER, FACING
from posetrack_cli.recording.base import TruthMessage
from posetrack_cli.results import (
    ESTIMATE_SCHEMA_NAME,
    Estimate,
    ResultWriter,
    Subject,
    estimate_to_json,
    load_arrays,
    read_result,
)
from posetrack_cli.results.export.export import FORMATS, TEXT_FORMATS, export_file, text_pieces
from posetrack_cli.results.export.source import export_source
from posetrack_cli.results.export.table import table_of
from posetrack_cli.results.fields import FIELD_NAMES
from support.results import CAMERA, RUN, SUBJECT, begin, make_estimate, with_fields, write_frames

FRAMES = 12
OF_FRAMES = sorted({*FORMATS} - {"rom"})  # which is of angles that this subject does not have
NO_VELOCITY: dict[str, object] = {"pose_rate": None, "twist": None, "twist_variance": None}
HEAD = replace(SUBJECT, name="head", shape_names=("width", "smile", "jaw"), triangles=None)
ROUNDING = 1e-12  # of a few float64 products, relative


def made(count: int = FRAMES) -> list[Estimate]:
    """Estimates of which the second knows no velocity; every seventh is lost, every fifth has no cost."""
    return [with_fields(make_estimate(i), **(NO_VELOCITY if i == 1 else {})) for i in range(count)]


def write(path: Path, estimates: list[Estimate], subject: Subject = SUBJECT, **run: str) -> Path:
    with ResultWriter(path, subject, CAMERA, RUN | run) as writer:
        for estimate in estimates:
            writer.write(estimate)
        writer.finish({})
    return path


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("result") / "r.mcap", made())


def text(path: Path, format_name: str, **options: Any) -> str:
    return "".join(text_pieces(export_source(read_result(path), **options), format_name))


def table(path: Path, **options: Any) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(text(path, "csv", **options))))


def numbers(rows: list[dict[str, str]], *names: str) -> np.ndarray:
    return np.array([[float(row[name] or "nan") for name in names] for row in rows])


def test_csv_holds_every_number_to_the_last_bit(path: Path) -> None:
    rows, estimates = table(path), made()
    assert [int(row["stamp_ns"]) for row in rows] == [e.stamp_ns for e in estimates]
    assert [row["status"] for row in rows] == [e.status.value for e in estimates]
    assert [row["resampled"] for row in rows] == [str(int(e.resampled)) for e in estimates]
    np.testing.assert_array_equal(numbers(rows, "x_mm", "y_mm", "z_mm"), [e.position for e in estimates])
    np.testing.assert_array_equal(numbers(rows, "qx", "qy", "qz", "qw"), [e.quaternion for e in estimates])
    angles = [f"{name}_rad" for name in SUBJECT.shape_names]
    np.testing.assert_array_equal(numbers(rows, *angles), [e.shape for e in estimates])
    points = [f"{name}_{axis}_mm" for name in SUBJECT.point_names for axis in "xyz"]
    np.testing.assert_array_equal(numbers(rows, *points), [e.points.ravel() for e in estimates])
    cost = [np.nan if e.cost is None else e.cost for e in estimates]
    np.testing.assert_array_equal(numbers(rows, "cost_mm")[:, 0], cost)


def test_csv_names_velocities_and_deviations_after_what_they_are(path: Path) -> None:
    row, estimate = table(path)[3], made()[3]
    assert estimate.twist is not None and estimate.twist_variance is not None
    rates = ["vx_mm_s", "vy_mm_s", "vz_mm_s", "wx_rad_s", "wy_rad_s", "wz_rad_s"]
    rates += [f"{name}_rad_s" for name in SUBJECT.shape_names]
    np.testing.assert_array_equal(numbers([row], *rates)[0], estimate.twist)
    sds = ["x_sd_mm", "y_sd_mm", "z_sd_mm", "rx_sd_rad", "ry_sd_rad", "rz_sd_rad"]
    sds += [f"{name}_sd_rad" for name in SUBJECT.shape_names]
    np.testing.assert_array_equal(numbers([row], *sds)[0], np.sqrt(estimate.pose_variance))
    rate_sds = [name.replace("_mm_s", "_sd_mm_s").replace("_rad_s", "_sd_rad_s") for name in rates]
    np.testing.assert_allclose(numbers([row], *rate_sds)[0] ** 2, estimate.twist_variance, rtol=ROUNDING)


def test_csv_angles_are_scipys(path: Path) -> None:
    yaw, pitch, roll = Rotation.from_quat([e.quaternion for e in made()]).as_euler("YXZ", degrees=True).T
    found = numbers(table(path), "roll_deg", "pitch_deg", "yaw_deg")
    np.testing.assert_allclose(found, np.stack([roll, pitch, yaw], axis=1), atol=1e-9)


def test_what_is_not_known_is_an_empty_cell(path: Path) -> None:
    rows = table(path)
    assert {rows[1][name] for name in ("vx_mm_s", "wz_rad_s", "index_mcp_x_rad_s", "vy_sd_mm_s")} == {""}
    assert rows[0]["cost_mm"] == "" != rows[1]["cost_mm"]
    assert {row["milliseconds"] for row in rows} == {""}


@pytest.mark.parametrize("format_name", ["tum", "json"])
def test_a_name_with_control_characters_is_written_escaped(
    path: Path, tmp_path: Path, format_name: str
) -> None:
    odd = tmp_path / "a\x1b[2J\x9b\u202e.mcap"
    odd.write_bytes(path.read_bytes())
    written = text(odd, format_name)
    assert not {"\x1b", "\x9b", "\u202e"} & set(written)
    assert "x1b[2J" in written or "u001b[2J" in written


def test_csv_is_a_header_row_and_numbers(path: Path) -> None:
    """As spreadsheets, pandas and R read it without being told anything; units stand in the names."""
    header, *rows = csv.reader(io.StringIO(text(path, "csv")))
    assert header == [name for group in table_of(SUBJECT, (CAMERA,)) for name in group.names]
    assert len(rows) == FRAMES and {len(row) for row in rows} == {len(header)}
    for name, column in zip(header, zip(*rows, strict=True), strict=True):
        assert name == "status" or all(np.isfinite(float(cell or 0)) for cell in column), name
    units = {"mm": "_mm", "rad": "_rad", "deg": "_deg", "mm/s": "_mm_s", "rad/s": "_rad_s", "px": "_px"}
    for group in table_of(SUBJECT, (CAMERA,)):
        assert all(name.endswith(units.get(group.unit, "")) for name in group.names), group
        assert group.unit or not any(name.endswith(tuple(units.values())) for name in group.names)


def test_lost_frames_can_be_left_out(path: Path) -> None:
    tracked = [e.frame_index for e in made() if e.status.value != "lost"]
    assert len(tracked) < FRAMES
    assert [int(row["frame_index"]) for row in table(path, lost=False)] == tracked
    assert "lost frames: left out" in text(path, "tum", lost=False)
    assert len(np.loadtxt(io.StringIO(text(path, "tum", lost=False)))) == len(tracked)
    assert json.loads(text(path, "json", lost=False))["columns"]["frame_index"] == tracked


def test_tum_is_seconds_metres_and_xyzw(path: Path) -> None:
    found = np.loadtxt(io.StringIO(text(path, "tum")))
    estimates = made()
    assert found.shape == (FRAMES, 8)
    np.testing.assert_allclose(found[:, 1:4] * 1e3, [e.position for e in estimates], rtol=ROUNDING)
    np.testing.assert_array_equal(found[:, 4:], [e.quaternion for e in estimates])
    stamps = [line.split()[0] for line in text(path, "tum").splitlines() if line[0] != "#"]
    assert stamps[1] == "1500000000.033333333"
    assert [int(stamp.replace(".", "")) for stamp in stamps] == [e.stamp_ns for e in estimates]


def test_json_has_the_columns_of_the_table_below_a_header(path: Path) -> None:
    values = json.loads(text(path, "json"))
    header, columns = values["header"], values["columns"]
    assert list(columns) == [name for group in table_of(SUBJECT, (CAMERA,)) for name in group.names]
    assert list(header["units"]) == list(columns) == list(header["meanings"])
    assert (header["units"]["x_mm"], header["units"]["yaw_deg"]) == ("mm", "deg")
    assert header["euler_order"] == EULER_ORDER
    assert (header["run"], header["subject"], header["finished"]) == (RUN, "hand", True)
    assert header["point_names"] == list(SUBJECT.point_names)
    assert columns["cost_mm"] == [e.cost for e in made()]
    assert columns["vx_mm_s"][1] is None
    assert columns["resampled"][:2] == [False, True]
    assert columns["qz"] == [e.quaternion[2] for e in made()]


def test_npz_holds_the_arrays_without_pickling(path: Path, tmp_path: Path) -> None:
    out = tmp_path / "r.npz"
    export_file(export_source(read_result(path)), "npz", out)
    expected = load_arrays(path)
    with np.load(out, allow_pickle=False) as found:
        assert tuple(found.files[: len(FIELD_NAMES)]) == FIELD_NAMES  # whatever order a set of them has
        for name in FIELD_NAMES:
            np.testing.assert_array_equal(found[name], expected[name])
        assert found["point_names"].tolist() == list(SUBJECT.point_names)
        np.testing.assert_array_equal(
            found["roll_pitch_yaw_deg"], numbers(table(path), "roll_deg", "pitch_deg", "yaw_deg")
        )
        header = json.loads(str(found["header"]))
        assert header["run"] == RUN
        assert set(header["units"]) <= set(found.files)


def test_a_heads_points_stand_still_in_its_own_axes(tmp_path: Path) -> None:
    """A rigid face that moves: its points are where they are in the model, whatever the pose."""
    model = np.array([[-43.0, 1.0, -3.0], [43.0, 1.0, -3.0], [0.0, -45.0, 25.0], [0.0, -66.0, 8.0]])
    heads = [
        with_fields(e, points=Rotation.from_quat(e.quaternion).apply(model) + e.position) for e in made()
    ]
    rows = table(write(tmp_path / "h.mcap", heads, HEAD))
    names = [f"{name}_{axis}_mm" for name in HEAD.point_names for axis in "xyz"]
    np.testing.assert_allclose(numbers(rows, *names), np.tile(model.ravel(), (FRAMES, 1)), atol=1e-9)
    meanings = json.loads(text(tmp_path / "h.mcap", "json"))["header"]["meanings"]
    assert {meanings[name] for name in names} == {"points in the head's own axes"}


def test_a_heads_angles_are_0_when_it_faces_the_camera_and_its_shape_has_no_unit(tmp_path: Path) -> None:
    facing = with_fields(make_estimate(0), quaternion=np.array(FACING))
    (row,) = table(write(tmp_path / "h.mcap", [facing], HEAD))
    assert [float(row[name]) for name in ("roll_deg", "pitch_deg", "yaw_deg")] == [0.0, 0.0, 0.0]
    assert float(row["smile"]) == facing.shape[1]
    assert facing.twist is not None
    assert float(row["smile_per_s"]) == facing.twist[7]
    assert float(row["smile_sd"]) == np.sqrt(facing.pose_variance[7])
    assert "half a turn about x" in json.loads(text(tmp_path / "h.mcap", "json"))["header"]["euler_order"]


@pytest.mark.parametrize("format_name", sorted({*TEXT_FORMATS} - {"rom"}))
def test_a_result_without_frames_is_a_header(tmp_path: Path, format_name: str) -> None:
    empty = write(tmp_path / "r.mcap", [])
    found = text(empty, format_name)
    if format_name == "json":
        assert json.loads(found)["columns"]["x_mm"] == []
    else:
        assert found.startswith("# ") == (format_name == "tum")
        assert len([line for line in found.splitlines() if line[0] != "#"]) == (format_name == "csv")


def test_truth_of_the_same_subject_is_exported_by_its_topic(tmp_path: Path) -> None:
    topic = "/truth/hand/estimate"
    truth = make_estimate(40)
    with begin(tmp_path / "r.mcap") as writer:
        write_frames(writer, 0, 3)
        writer.add_truth(truth_message(topic, truth))
        writer.finish({})
    (row,) = table(tmp_path / "r.mcap", topic=topic)
    assert int(row["frame_index"]) == 40
    assert f"topic {topic}" in text(tmp_path / "r.mcap", "tum", topic=topic)
    with pytest.raises(ResultError, match="did you mean"):
        export_source(read_result(tmp_path / "r.mcap"), topic="/truth/hand/estimates")


def truth_message(topic: str, truth: Estimate) -> TruthMessage:
    data = estimate_to_json(truth)
    return TruthMessage(topic, ESTIMATE_SCHEMA_NAME, "jsonschema", b"{}", "json", truth.stamp_ns, data)


@pytest.mark.parametrize("format_name", sorted({*FORMATS} - {"protobuf"}))  # which exports all topics
def test_estimates_of_another_subject_leave_no_file(tmp_path: Path, format_name: str) -> None:
    topic, out = "/truth/other/estimate", tmp_path / "out"
    with begin(tmp_path / "r.mcap") as writer:
        writer.add_truth(truth_message(topic, make_estimate(0, k=5, p=2)))
        write_frames(writer, 0, 1)
        writer.finish({})
    source = export_source(read_result(tmp_path / "r.mcap"), topic)
    with pytest.raises(ResultError, match="found 5 shape parameters and 2 points, expected 3 and 4"):
        export_file(source, format_name, out)
    if format_name in TEXT_FORMATS:
        with pytest.raises(ResultError):  # nothing is written before the first estimate is known to fit
            next(text_pieces(source, format_name))
    assert [path.name for path in tmp_path.iterdir()] == ["r.mcap"]


@pytest.mark.parametrize("format_name", OF_FRAMES)
def test_two_exports_are_the_same_bytes(path: Path, tmp_path: Path, format_name: str) -> None:
    source = export_source(read_result(path))
    for name in ("a", "b"):
        export_file(source, format_name, tmp_path / name)
    assert filecmp.cmp(tmp_path / "a", tmp_path / "b", shallow=False)


def test_names_in_any_script_and_with_commas_survive(tmp_path: Path) -> None:
    subject = replace(SUBJECT, point_names=("手首", 'index, "mcp"', "pip", "cmc"))
    odd = write(tmp_path / "ergebnis_ü.mcap", made(2), subject, **{"input.name": "a\nb"})
    row = table(odd)[0]
    assert float(row["手首_x_mm"]) == make_estimate(0).points[0, 0]
    assert float(row['index, "mcp"_z_mm']) == make_estimate(0).points[1, 2]
    assert json.loads(text(odd, "json"))["header"]["result"] == "ergebnis_ü.mcap"
    assert len(np.loadtxt(io.StringIO(text(odd, "tum")))) == 2, "no line break of a name ends a comment"


def test_missing_data_is_told_in_the_header(path: Path, tmp_path: Path) -> None:
    (tmp_path / "cut.mcap").write_bytes(path.read_bytes()[:-40])
    found = text(tmp_path / "cut.mcap", "tum")
    assert "# missing data: file is truncated" in found
    assert ", unfinished" not in found, "its summary is there"
    assert "truncated" in json.loads(text(tmp_path / "cut.mcap", "json"))["header"]["losses"]


def test_npz_is_no_text(path: Path) -> None:
    with pytest.raises(UsageError, match="npz is not a text format, expected csv, tum, json"):
        text(path, "npz")
