"""NWB files, read by pynwb, and by movement and sleap-io where they are installed."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from posetrack_cli.errors import ResultError, UsageError
from posetrack_cli.results import Result, ResultWriter, read_result
from posetrack_cli.results.export.export import export_file
from posetrack_cli.results.export.source import FIRST_UNIX_NS, export_source
from support.hand_results import STEP_NS, hand, write
from support.results import CAMERA, RUN, SUBJECT, make_estimate

pynwb = pytest.importorskip("pynwb", reason="pynwb, of the extra nwb, is not installed")
LOST = (4, 9)
START_NS = 1_700_000_000_123_456_789
SINGLE = 1e-4  # px; float32 at 1000 px


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Result:
    folder = tmp_path_factory.mktemp("result")
    return read_result(write(folder / "r.mcap", hand("left"), lost=LOST, first_ns=START_NS))


@pytest.fixture(scope="module")
def path(result: Result, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("nwb") / "r.nwb"
    export_file(export_source(result), "nwb", out)
    return out


@pytest.fixture
def file(path: Path) -> Iterator[Any]:
    with pynwb.NWBHDF5IO(path, "r") as stream:
        yield stream.read()


def tracked_points(result: Result) -> np.ndarray:
    arrays = result.to_numpy()
    return np.where((arrays["status"] == "lost")[:, None, None], np.nan, arrays["points"])


def test_the_file_follows_the_schemas(path: Path) -> None:
    assert pynwb.validate(path=path) == []


def test_series_hold_the_points_in_metres_when_converted(file: Any, result: Result) -> None:
    estimation = file.processing["behavior"]["PoseEstimation"]
    points = tracked_points(result)
    assert np.isnan(points[list(LOST)]).all()
    for name, expected in zip(result.subject.point_names, np.moveaxis(points, 1, 0), strict=True):
        series = estimation[name]
        np.testing.assert_array_equal(series.data[:], expected)
        assert (series.unit, series.conversion) == ("meters", 1e-3)
        np.testing.assert_array_equal(series.confidence[:], result.to_numpy()["confidence"])
    assert estimation.source_software == "posetrack"


def test_times_count_from_the_first_frame_of_unix_stamps(file: Any, result: Result) -> None:
    start = datetime(2023, 11, 14, 22, 13, 20, 123456, UTC)  # START_NS, by `date -u -d @1700000000`
    assert file.session_start_time == start
    stamps = result.to_numpy()["stamp_ns"]
    expected = (stamps - START_NS) * 1e-9 + 789e-9
    for series in file.processing["behavior"]["PoseEstimation"].pose_estimation_series.values():
        np.testing.assert_allclose(series.timestamps[:], expected, rtol=0, atol=1e-12)


def test_the_skeleton_and_the_camera_are_those_of_the_result(file: Any, result: Result) -> None:
    estimation = file.processing["behavior"]["PoseEstimation"]
    skeleton, camera = estimation.skeleton, estimation.device
    assert list(skeleton.nodes[:]) == list(result.subject.point_names)
    parents = [(p, k) for k, p in enumerate(result.subject.point_parents) if p >= 0]
    assert [tuple(edge) for edge in skeleton.edges[:].tolist()] == parents
    np.testing.assert_array_equal(camera.intrinsic_matrix[:], CAMERA.matrix)
    np.testing.assert_array_equal(camera.distortion_coefficients[:], CAMERA.distortion)
    np.testing.assert_array_equal(camera.rotation_matrix[:], np.eye(3))


def test_image_points_are_in_a_module_of_the_camera(file: Any, result: Result) -> None:
    (name,) = (name for name in file.processing if name != "behavior")
    for k, point in enumerate(result.subject.point_names):
        series = file.processing[name]["track0"][point]
        np.testing.assert_array_equal(series.data[:], result.to_numpy()["pixels"][:, 0, k])
        assert series.unit == "pixels"


def test_a_given_start_dates_stamps_that_are_no_unix_time(tmp_path: Path) -> None:
    result = read_result(write(tmp_path / "r.mcap", hand("right"), first_ns=5 * STEP_NS))
    with pytest.raises(UsageError, match=r"start of the session is unknown, .*; pass --session-start"):
        export_file(export_source(result), "nwb", tmp_path / "r.nwb")
    assert [path.name for path in tmp_path.iterdir()] == ["r.mcap"]
    source = export_source(result, session_start_ns=FIRST_UNIX_NS)
    export_file(source, "nwb", tmp_path / "r.nwb")
    with pynwb.NWBHDF5IO(tmp_path / "r.nwb", "r") as stream:
        file = stream.read()
        assert file.session_start_time == datetime(2000, 1, 1, tzinfo=UTC)
        times = file.processing["behavior"]["PoseEstimation"]["wrist"].timestamps[:]
    np.testing.assert_allclose(times, np.arange(len(times)) * STEP_NS * 1e-9, rtol=0, atol=1e-12)


def test_a_session_that_begins_before_its_recording_keeps_the_stamps(result: Result, tmp_path: Path) -> None:
    export_file(export_source(result, session_start_ns=START_NS - 60 * 10**9), "nwb", tmp_path / "r.nwb")
    with pynwb.NWBHDF5IO(tmp_path / "r.nwb", "r") as stream:
        assert stream.read().processing["behavior"]["PoseEstimation"]["wrist"].timestamps[0] == 60.0


def test_no_estimates_and_odd_names_are_one_line(tmp_path: Path) -> None:
    for names, match in (((), "has no estimates"), (("a/b", "a:b", "c", "d"), "cannot be written as NWB")):
        subject = (
            SUBJECT if not names else type(SUBJECT)("hand", "kinect", ("a", "b", "c"), names, (-1, 0, 1, 0))
        )
        path = tmp_path / f"{len(names)}.mcap"
        with ResultWriter(path, subject, CAMERA, RUN) as writer:
            if names:
                writer.write(make_estimate(0))
            writer.finish({})
        with pytest.raises(ResultError, match=match):
            export_file(export_source(read_result(path)), "nwb", tmp_path / "r.nwb")


def test_movement_reads_the_points(path: Path, result: Result) -> None:
    load_poses = pytest.importorskip("movement.io.load_poses", reason="movement is not installed")
    data = load_poses.from_nwb_file(path)
    keypoint = "keypoints" if "keypoints" in data.dims else "keypoint"
    found = data.position.transpose("time", keypoint, "space", ...).sel(
        {keypoint: list(result.subject.point_names)}
    )
    np.testing.assert_array_equal(found.values[..., 0], tracked_points(result))


def test_sleap_io_reads_the_image_points(path: Path, result: Result) -> None:
    sleap_io = pytest.importorskip("sleap_io", reason="sleap-io is not installed")
    labels = sleap_io.load_nwb(path)
    assert labels.skeleton.node_names == list(result.subject.point_names)
    pixels = result.to_numpy()["pixels"][:, 0]
    seen = pixels[~np.isnan(pixels).all(axis=(1, 2))]
    found = np.stack([frame.instances[0].numpy() for frame in labels])
    np.testing.assert_allclose(found, seen, rtol=0, atol=SINGLE)
