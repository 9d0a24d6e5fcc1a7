"""``posetrack hand calibrate``: what it prints and refuses, and that ``hand run`` reads what it writes."""

from __future__ import annotations

import contextlib
import io
import re
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

from posetrack_cli.cli.calibrate import hand_calibrate
from posetrack_cli.cli.main import run
from posetrack_cli.configuration import load_settings
from posetrack_cli.hand import autodetect
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.hand.model.anatomy import COEFFICIENTS, HandShape
from posetrack_cli.hand.model.hand import hand_model
from posetrack_cli.hand.shape_fit import MEASURES, CalibrationOptions, measures_of
from posetrack_cli.recording.opening import open_recording
from posetrack_cli.results import load_arrays
from posetrack_cli.synthesis.hand.frames import write_synthetic
from posetrack_cli.synthesis.hand.options import SynthOptions, hand_of_seed
from support.calibrations import calibration_of
from support.recordings import write_folder

QUICK = ("--hand-side", "right", "--fit-frames", "8")
FEW = "[acquisition]\nfitted = 16\nrefined = 2\nscattered = 4\n"
"""Hypotheses of a search for the one hand in the image; ``hand run`` below takes the usual ones."""


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("calibrate") / "hand.mcap"
    write_synthetic(SynthOptions(frames=12, seed=4, speed=4.0, **asdict(hand_of_seed(4))), path)
    return path


def calibrate(recording: Path, output: Path, *more: str) -> int:
    few = recording.with_name("few.toml")
    few.write_text(FEW)
    return run(["hand", "calibrate", str(recording), "-o", str(output), "--config", str(few), *more])


@pytest.fixture(scope="module")
def calibrated(recording: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[str]]:
    """A configuration that was written, and the lines that were printed."""
    output, printed = tmp_path_factory.mktemp("calibrated") / "hand.toml", io.StringIO()
    with contextlib.redirect_stdout(printed):
        assert calibrate(recording, output, *QUICK) == 0
    return output, printed.getvalue().splitlines()


def one_line(capsys: pytest.CaptureFixture[str]) -> str:
    lines = capsys.readouterr().err.strip().splitlines()
    assert "Traceback" not in "".join(lines)
    return lines[-1]


def test_a_table_and_a_configuration(
    recording: Path, calibrated: tuple[Path, list[str]], tmp_path: Path
) -> None:
    output, (*shown, following) = calibrated
    assert following.startswith(f"next: posetrack hand run {recording} --shape {output} -o ")
    assert shown[0].split() == ["side", "right"] and shown[1].split() == ["mm", "sd"]
    rows = {" ".join(line.split()[:-2]): line.split()[-2:] for line in shown[2:-1]}
    assert list(rows) == [*(name.replace("_", " ") for name in MEASURES), "padding"]
    hand = load_settings(HandConfig, [output], {}).hand
    assert len(hand.coefficients) == COEFFICIENTS and hand.finger_lengths == (1.0,) * 5
    measures = [*measures_of(hand_model(hand).anatomy), hand.padding_mm]
    for printed, measure in zip(rows.values(), measures, strict=True):
        value, sd = map(float, printed)
        assert value == pytest.approx(measure, abs=0.06) and 0.0 < sd < 15.0  # numbers of one decimal
    used, seen = map(int, re.findall(r"(\d+) of (\d+) frames", shown[-1])[0])
    assert shown[-1].startswith(f"{output}: ") and 4 <= used <= 8 and 8 <= seen <= 12
    # what is written is what a run takes, alone or over a configuration
    result = tmp_path / "r.mcap"
    arguments = ["hand", "run", str(recording), "-o", str(result), "--particles", "16", "--end", "2"]
    assert run([*arguments, "--config", "hand", "--shape", str(output)]) in (0, 3)
    arguments[4] = str(tmp_path / "c.mcap")
    assert run([*arguments, "--config", str(output)]) in (0, 3)
    points = [load_arrays(path)["points"] for path in (result, tmp_path / "c.mcap")]
    np.testing.assert_array_equal(*points)


def test_an_existing_file_is_kept_or_replaced_by_the_same_hand(
    recording: Path,
    calibrated: tuple[Path, list[str]],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    output = tmp_path / "hand.toml"
    output.write_text("precious")
    assert calibrate(recording, output, *QUICK) == 2
    assert "--overwrite" in one_line(capsys)
    assert output.read_text() == "precious"
    assert calibrate(recording, output, *QUICK, "--overwrite") == 0
    assert output.read_bytes() == calibrated[0].read_bytes()


@pytest.mark.parametrize(
    ("shape", "said"),
    [(HandShape(1.3), "a right hand, 233 mm long, outside 120 to 225 mm"), (HandShape(), None)],
)
def test_what_is_doubtful_is_said(
    recording: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    shape: HandShape,
    said: str | None,
) -> None:
    monkeypatch.setattr(autodetect, "calibrate", lambda *arguments: calibration_of(shape))
    assert calibrate(recording, tmp_path / "hand.toml") == 0
    lines = capsys.readouterr().err.splitlines()
    assert [line for line in lines if " mm long" in line] == lines
    assert len(lines) == (said is not None) and all(f"{recording}: {said}" in line for line in lines)


def test_the_recording_is_never_replaced(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = recording.read_bytes()
    assert calibrate(recording, recording, "--overwrite") == 2
    assert "would replace the recording" in one_line(capsys)
    assert recording.read_bytes() == before


@pytest.mark.parametrize("frames", ["3", "-1", "nan", "201"])
def test_too_few_frames_or_too_many(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], frames: str
) -> None:
    assert calibrate(recording, tmp_path / "hand.toml", "--fit-frames", frames) == 2
    assert "--fit-frames" in one_line(capsys)
    assert not list(tmp_path.iterdir())


def test_a_hand_is_fitted_to_as_many_frames_as_before_a_run() -> None:
    stated = {parameter.name: parameter.default for parameter in hand_calibrate.params}
    assert stated["fit_frames"] == CalibrationOptions().frames


def test_missing_recording_folder_and_mesh(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert calibrate(tmp_path / "none", tmp_path / "hand.toml") == 1
    assert "no such file or folder" in one_line(capsys)
    assert calibrate(recording, tmp_path / "no" / "hand.toml") == 1
    assert "no folder" in one_line(capsys)
    assert calibrate(recording, tmp_path / "hand.toml", "--hand-mesh", str(tmp_path / "none.glb")) == 2
    assert "none.glb: cannot be read" in one_line(capsys)


def test_a_recording_too_short_to_say_anything(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The hand must be found in all of three frames; here it leaves after the second."""
    opened, output = open_recording(recording), tmp_path / "hand.toml"
    images = [frame.depth.astype(np.uint16) for frame in opened.frames(start=0, end=3, stride=1)]
    camera = "".join(f"{name} = {getattr(opened.cameras[0], name)}\n" for name in ("fx", "fy", "cx", "cy"))
    short = write_folder(tmp_path / "short", [*images[:2], np.zeros_like(images[2])], camera=camera)
    assert calibrate(short, output, "--hand-side", "right") == 1
    assert "no trackable hand" in one_line(capsys)
    assert not output.exists()
