"""``posetrack hand calibrate``: what it prints and refuses, and that ``hand run`` reads what it writes."""

from __future__ import annotations

import contextlib
import io
from dataclasses import asdict
from pathlib import Path

import pytest

from posetrack_cli.cli.main import run
from posetrack_cli.configuration import load_settings
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.hand.shape import SHAPE_NAMES
from posetrack_cli.synthesis.hand.options import SynthOptions, hand_of_seed
from posetrack_cli.synthesis.hand.writing import write_synthetic

QUICK = ("--hand-side", "right", "--frames", "4", "--seconds", "0.2")
FEW = "[acquisition]\nfitted = 16\nrefined = 2\nscattered = 4\n"
"""Hypotheses of a search for the one hand in the image; ``hand run`` below takes the usual ones."""


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("calibrate") / "hand.mcap"
    write_synthetic(SynthOptions(frames=10, seed=4, speed=4.0, **asdict(hand_of_seed(4))), path)
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
    output, shown = calibrated
    assert shown[0].split() == ["side", "right"]
    rows = {" ".join(line.split()[:-2]): line.split()[-2:] for line in shown[2:-1]}
    assert list(rows) == [name.replace("_", " ") for name in SHAPE_NAMES]
    hand = load_settings(HandConfig, [output], {}).hand
    for name, factor in zip(SHAPE_NAMES, hand.shape.factors, strict=True):
        value, sd = map(float, rows[name.replace("_", " ")])
        assert value == pytest.approx(factor, abs=6e-4) and 0.0 < sd < 0.5
    assert shown[-1].startswith(f"{output}: 4 of ")
    # the recording's own configuration comes first, the hand over it
    result = tmp_path / "r.mcap"
    arguments = ["hand", "run", str(recording), "-o", str(result), "--particles", "16", "--end", "2"]
    assert run([*arguments, "--config", "hand", "--config", str(output)]) in (0, 3)


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


def test_the_recording_is_never_replaced(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = recording.read_bytes()
    assert calibrate(recording, recording, "--overwrite") == 2
    assert "would replace the recording" in one_line(capsys)
    assert recording.read_bytes() == before


@pytest.mark.parametrize("seconds", ["0", "-1", "nan", "1e9"])
def test_no_time_at_all(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], seconds: str
) -> None:
    assert calibrate(recording, tmp_path / "hand.toml", "--seconds", seconds) == 2
    assert "--seconds cannot be used" in one_line(capsys)
    assert not list(tmp_path.iterdir())


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
    assert calibrate(recording, tmp_path / "hand.toml", "--hand-side", "right", "--seconds", "0.05") == 1
    assert "no hand that can be tracked" in one_line(capsys)
