"""The two tracks of a result in ``posetrack eval``, ``view`` and ``export``."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from posetrack_cli.cli.main import run
from posetrack_cli.recording.opening import open_recording
from posetrack_cli.results import load_arrays, read_result
from support.eval_command import write_result
from support.viewing import make_recording, make_result, moved, pictures_of

FRAMES = 90


@pytest.fixture(scope="module")
def both(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Filtered off by noise of 8 mm, smoothed by noise of 2 mm."""
    path = tmp_path_factory.mktemp("both") / "r.mcap"
    return write_result(path, FRAMES, error_mm=8.0, smoothed_mm=2.0)


@pytest.fixture(scope="module")
def filtered_only(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_result(tmp_path_factory.mktemp("one") / "f.mcap", FRAMES, error_mm=8.0)


def report(capsys: pytest.CaptureFixture[str], *arguments: object) -> dict:
    assert run(["eval", *map(str, arguments), "--json", "-"]) == 0
    return json.loads(capsys.readouterr().out)


def errors(found: dict) -> dict[str, float]:
    return {one["name"]: one["metrics"]["joint_error_mm"]["mean"] for one in found["results"]}


def test_eval_measures_the_filtered_track_unless_it_is_told_otherwise(
    both: Path, filtered_only: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert errors(report(capsys, both))["r"] == errors(report(capsys, filtered_only))["f"]
    assert errors(report(capsys, both, "--track", "filtered")) == errors(report(capsys, both))
    smoothed = report(capsys, both, "--track", "smoothed")
    assert errors(smoothed)["r"] < 0.5 * errors(report(capsys, both))["r"]
    assert [one["track"] for one in smoothed["results"]] == ["smoothed"]
    assert any("later frames" in note for note in smoothed["results"][0]["notes"])


def test_both_tracks_stand_beside_each_other_and_are_compared(
    both: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = report(capsys, both, "--track", "both")
    assert [(one["name"], one["track"]) for one in found["results"]] == [
        ("r", "filtered"),
        ("r smoothed", "smoothed"),
    ]
    (difference,) = [d for d in found["comparison"]["differences"] if d["figure"] == "joint_error_mm"]
    assert (difference["first"], difference["second"]) == ("r", "r smoothed")
    means = errors(found)
    # every second weighs alike, whether 29 or 31 frames fall into it
    assert difference["difference"] == pytest.approx(means["r smoothed"] - means["r"], rel=1.0 / 30.0)
    assert difference["count"] == 3  # seconds


def test_a_result_without_a_smoothed_track_stands_alone_beside_one_that_has(
    both: Path, filtered_only: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = report(capsys, filtered_only, both, "--track", "both")
    assert [one["name"] for one in found["results"]] == ["f", "r", "r smoothed"]


@pytest.mark.parametrize("track", ["smoothed", "both"])
def test_to_ask_for_a_track_that_nothing_has_is_an_error(
    filtered_only: Path, track: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["eval", str(filtered_only), "--track", track]) == 1
    assert "f.mcap: has no smoothed track; posetrack hand run --smooth" in capsys.readouterr().err


def test_each_track_of_a_group_has_a_group_of_its_own(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, recording in (("a", "aa"), ("b", "bb"), ("c", "cc")):
        write_result(tmp_path / f"{name}.mcap", 30, 8.0, recording, smoothed_mm=2.0)
    found = report(capsys, "--group", f"rbpf={tmp_path}/*.mcap", "--track", "both")["comparison"]
    assert set(found["groups"]) == {"rbpf", "rbpf smoothed"}
    (difference,) = [d for d in found["differences"] if d["figure"] == "joint_error_mm.mean"]
    assert (difference["first"], difference["second"], difference["count"]) == ("rbpf", "rbpf smoothed", 3)
    assert difference["difference"] < 0.0


def test_a_page_shows_both_tracks_and_its_gates_judge_the_filtered_one(
    both: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    gate = ["--fail-if", "joint_error_mm.mean < 5"]  # the smoothed track alone would fail it
    page = tmp_path / "r.html"
    assert run(["eval", str(both), "--html", str(page), *gate]) == 0
    table = capsys.readouterr().out
    data = json.loads(page.read_text().split('id="report-data">')[1].split("</script>")[0])
    assert [one["name"] for one in data["results"]] == ["r", "r smoothed"]
    assert all(one["curve"] for one in data["results"])
    assert "smoothed" not in table
    assert run(["eval", str(both), "--html", str(page), "--overwrite", "--track", "filtered"]) == 0
    assert "r smoothed" not in page.read_text()


def test_export_writes_either_track(both: Path, tmp_path: Path) -> None:
    result = read_result(both)
    for track in ("filtered", "smoothed"):
        out = tmp_path / f"{track}.csv"
        assert run(["export", str(both), "-o", str(out), "--track", track]) == 0
        kept = [line for line in out.read_text().splitlines() if not line.startswith("#")]
        xs = [float(row["x_mm"]) for row in csv.DictReader(kept)]
        np.testing.assert_array_equal(xs, load_arrays(both, result.topic_of_track(track))["position"][:, 0])


def test_export_takes_a_topic_or_a_track(both: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["export", str(both), "--estimate-topic", "/hand/estimate", "--track", "smoothed"]) == 2
    assert "--estimate-topic and --track are mutually exclusive" in capsys.readouterr().err


def test_view_draws_both_tracks_beside_each_other(tmp_path: Path) -> None:
    """The smoothed hand is drawn where it is: 60 mm from the filtered one, on the right half."""
    recording = make_recording(tmp_path / "in.mcap", 2)
    opened = open_recording(recording)
    make_result(tmp_path / "r.mcap", opened, smoothed=moved(60.0))
    make_result(tmp_path / "moved.mcap", opened, moved(60.0))
    common = ["--recording", str(recording), "--range-mm", "400", "1200"]
    for name, track in (("filtered", "filtered"), ("smoothed", "smoothed"), ("both", "both")):
        out = str(tmp_path / f"{name}.mp4")
        assert run(["view", str(tmp_path / "r.mcap"), "-o", out, "--track", track, *common]) == 0
    assert run(["view", str(tmp_path / "moved.mcap"), "-o", str(tmp_path / "moved.mp4"), *common]) == 0
    filtered, smoothed, other, beside = (
        pictures_of(tmp_path / f"{name}.mp4")[0] for name in ("filtered", "smoothed", "moved", "both")
    )
    np.testing.assert_array_equal(smoothed, other)
    assert np.abs(filtered.astype(int) - smoothed).mean() > 1.0
    half = beside.shape[1] // 2
    assert np.abs(beside[:, :half].astype(int) - beside[:, half:]).mean() > 1.0
