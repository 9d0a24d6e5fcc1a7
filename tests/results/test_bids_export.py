"""BIDS Motion, read by the rules of its specification (1.10: file names, tables, sidecars)."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from posetrack_cli.cli.main import run
from posetrack_cli.errors import EXIT_DONE, EXIT_USAGE, UsageError
from posetrack_cli.results import Result, read_result
from posetrack_cli.results.export.bids import write_bids
from posetrack_cli.results.export.source import export_source
from support.hand_results import FRAMES, STEP_NS, hand, write

LOST = (4, 9)
START_NS = 1_700_000_000_000_000_000
NAME = re.compile(
    r"sub-[0-9a-zA-Z]+(_ses-[0-9a-zA-Z]+)?_task-[0-9a-zA-Z]+_tracksys-[0-9a-zA-Z]+(_acq-[0-9a-zA-Z]+)?(_run-[0-9]+)?"
    r"_(motion\.tsv|motion\.json|channels\.tsv|channels\.json)"
)
TYPES = {"ACCEL", "ANGACCEL", "GYRO", "JNTANG", "LATENCY", "MAGN", "MISC", "ORNT", "POS", "VEL"}
COMPONENTS = {"x", "y", "z", "quat_x", "quat_y", "quat_z", "quat_w", "n/a"}


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Result:
    folder = tmp_path_factory.mktemp("result")
    return read_result(write(folder / "r.mcap", hand("right"), lost=LOST, first_ns=START_NS))


def table(path: Path) -> list[dict[str, str]]:
    header, *rows = (line.split("\t") for line in path.read_text(encoding="utf-8").splitlines())
    return [dict(zip(header, row, strict=True)) for row in rows]


def read_motion(motion: Path) -> dict[str, np.ndarray]:
    """Values of each channel by its name, as the table of channels gives them an order."""
    lines = [line.split("\t") for line in motion.read_text(encoding="utf-8").splitlines()]
    channels = table(motion.with_name(motion.name.replace("_motion.", "_channels.")))
    values = np.array([[np.nan if cell == "n/a" else float(cell) for cell in line] for line in lines])
    return dict(zip((channel["name"] for channel in channels), values.T, strict=True))


def test_the_dataset_has_the_files_that_bids_asks_for(result: Result, tmp_path: Path) -> None:
    root = tmp_path / "study"
    motion = write_bids(export_source(result), root / "sub-01_task-reach")
    assert motion == root / "sub-01" / "motion" / "sub-01_task-reach_tracksys-hand_motion.tsv"
    assert len(list(motion.parent.iterdir())) == 4
    assert all(NAME.fullmatch(file.name) for file in motion.parent.iterdir())
    description = json.loads((root / "dataset_description.json").read_text())
    assert description["Name"] == "study" and re.fullmatch(r"1\.\d+\.\d+", description["BIDSVersion"])
    assert (root / "README.md").stat().st_size > 0
    assert table(root / "participants.tsv") == [{"participant_id": "sub-01"}]
    assert table(root / "sub-01" / "sub-01_scans.tsv") == [
        {"filename": f"motion/{motion.name}", "acq_time": "2023-11-14T22:13:20Z"}
    ]


def test_channels_are_described_and_hold_the_track(result: Result, tmp_path: Path) -> None:
    motion = write_bids(export_source(result), tmp_path / "sub-01_task-reach")
    channels = table(motion.with_name(motion.name.replace("motion.tsv", "channels.tsv")))
    assert list(channels[0])[:5] == ["name", "component", "type", "tracked_point", "units"]
    assert {channel["type"] for channel in channels} <= TYPES
    assert {channel["component"] for channel in channels} <= COMPONENTS
    frames = json.loads(motion.with_name(motion.name.replace("motion.tsv", "channels.json")).read_text())
    levels = frames["reference_frame"]["Levels"]
    assert {channel["reference_frame"] for channel in channels} <= {*levels, "n/a"}
    values, arrays = read_motion(motion), result.to_numpy()
    lost = arrays["status"] == "lost"
    for k, name in enumerate(result.subject.point_names):
        found = np.stack([values[f"{name}_{axis}"] for axis in "xyz"], axis=1)
        np.testing.assert_allclose(found[~lost], 1e-3 * arrays["points"][~lost, k], rtol=1e-15)
        assert np.isnan(found[lost]).all() and lost.any()
    turns = np.stack([values[f"hand_quat_{axis}"] for axis in "xyzw"], axis=1)
    np.testing.assert_array_equal(turns[~lost], arrays["quaternion"][~lost])
    angles = np.stack([values[name] for name in result.angle_names], axis=1)
    np.testing.assert_array_equal(angles[~lost], arrays["joint_angles_deg"][~lost])
    np.testing.assert_allclose(values["latency"], np.arange(FRAMES) * STEP_NS * 1e-9, rtol=0, atol=1e-9)
    units = {channel["type"]: channel["units"] for channel in channels}
    assert (units["POS"], units["JNTANG"], units["LATENCY"], units["ORNT"]) == ("m", "deg", "s", "n/a")


def test_the_sidecar_counts_what_there_is(result: Result, tmp_path: Path) -> None:
    motion = write_bids(export_source(result), tmp_path / "sub-01_task-reach")
    about = json.loads(motion.with_suffix(".json").read_text())
    channels = table(motion.with_name(motion.name.replace("motion.tsv", "channels.tsv")))
    assert about["TaskName"] == "reach"
    assert about["SamplingFrequency"] == pytest.approx(1e9 / STEP_NS)
    assert about["SamplingFrequencyEffective"] == pytest.approx(1e9 / STEP_NS)
    assert about["MotionChannelCount"] == len(channels)
    for kind in TYPES:
        assert about[f"{kind}ChannelCount"] == sum(channel["type"] == kind for channel in channels)
    assert about["TrackedPointsCount"] == len({c["tracked_point"] for c in channels if c["type"] == "POS"})


def test_the_path_of_a_motion_file_can_be_typed_instead(
    result: Result, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    motion = tmp_path / "study/sub-02/ses-a/motion/sub-02_ses-a_task-reach_tracksys-right_run-1_motion.tsv"
    command = ["export", str(result.path), "-o", str(motion)]
    assert run(command) == EXIT_DONE
    assert capfd.readouterr().out == f"{motion}: bids, {motion.stat().st_size} bytes\n"
    assert (tmp_path / "study" / "sub-02" / "ses-a" / "sub-02_ses-a_scans.tsv").is_file()
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    assert run(command) == EXIT_USAGE
    assert "already exists; use --overwrite" in capfd.readouterr().err
    assert run([*command, "--overwrite"]) == EXIT_DONE
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before


def test_another_track_is_added_and_what_people_wrote_is_kept(result: Result, tmp_path: Path) -> None:
    (tmp_path / "participants.tsv").write_text("participant_id\tage\nsub-07\t31\n")
    (tmp_path / "README").write_text("ours")
    (tmp_path / "dataset_description.json").write_text("{}")
    for name in ("sub-01_task-reach", "sub-07_task-reach", "sub-07_task-grasp"):
        write_bids(export_source(result), tmp_path / name)
    assert table(tmp_path / "participants.tsv") == [
        {"participant_id": "sub-07", "age": "31"},
        {"participant_id": "sub-01", "age": "n/a"},
    ]
    scans = table(tmp_path / "sub-07" / "sub-07_scans.tsv")
    assert [re.findall("task-([a-z]+)", row["filename"]) for row in scans] == [["reach"], ["grasp"]]
    assert (tmp_path / "dataset_description.json").read_text() == "{}"
    assert not (tmp_path / "README.md").exists()


@pytest.mark.parametrize(
    "name",
    [
        "study",
        "sub-01",
        "task-reach",
        "sub-01_task-re ach",
        "task-reach_sub-01",
        "sub-01_task-a_space-b",
        "sub-_task-a",
        "sub-01_task-a_run-b",
    ],
)
def test_other_names_are_refused(result: Result, tmp_path: Path, name: str) -> None:
    with pytest.raises(UsageError, match=r"not a name of BIDS, found .*, expected DATASET/sub-01_task-reach"):
        write_bids(export_source(result), tmp_path / name)
    assert list(tmp_path.iterdir()) == []


def test_stamps_without_a_date_are_not_dated(tmp_path: Path) -> None:
    result = read_result(write(tmp_path / "r.mcap", hand("right")))
    write_bids(export_source(result), tmp_path / "study" / "sub-01_task-reach")
    assert not list((tmp_path / "study").rglob("*_scans.tsv"))
