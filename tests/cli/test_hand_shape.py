"""``posetrack hand run --shape``: estimated by default, told as average or by a file, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from posetrack_cli.cli.main import run
from posetrack_cli.hand import autodetect
from posetrack_cli.hand import run as hand_run_module
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.hand.model.anatomy import HandShape, make_anatomy
from posetrack_cli.hand.shape_fit import Calibration, CalibrationOptions, write_hand_file
from posetrack_cli.recording.recording import Recording
from posetrack_cli.results import load_arrays, read_result
from posetrack_cli.synthesis.hand.frames import write_synthetic
from posetrack_cli.synthesis.hand.options import SynthOptions
from support.calibrations import calibration_of
from support.glb import write_hand
from support.hand import REST
from support.results import RUN, write_result

SHAPE = HandShape(0.8, coefficients=(1.5, -1.0))
FRAMES, REST_HAND = 6, make_anatomy()
FEW = ("--particles", "16", "--end", "2", "--set", "acquisition.fitted=16", "--set", "acquisition.refined=2")


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A child's hand: none that the average hand explains."""
    path = tmp_path_factory.mktemp("shape") / "hand.mcap"
    write_synthetic(SynthOptions(frames=FRAMES, seed=3, scale=SHAPE.scale), path)
    return path


@pytest.fixture(scope="module")
def hand_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("files") / "hand.toml"
    write_hand_file(path, calibration_of(SHAPE), None, "hand.mcap")
    return path


@pytest.fixture
def estimated(monkeypatch: pytest.MonkeyPatch) -> list[CalibrationOptions]:
    """How shapes were asked for, which are found at once."""
    asked: list[CalibrationOptions] = []

    def shape_of(recording: Recording, config: HandConfig, options: CalibrationOptions) -> Calibration:
        asked.append(options)
        return calibration_of(SHAPE)

    monkeypatch.setattr(autodetect, "shape_of", shape_of)
    return asked


@pytest.fixture
def used(monkeypatch: pytest.MonkeyPatch) -> list[HandConfig]:
    """The configurations of runs, which are not done."""
    configs: list[HandConfig] = []

    class Stopped(hand_run_module.HandRun):
        def __init__(self, recording: Recording, config: HandConfig, *others: object) -> None:
            configs.append(config)
            raise KeyboardInterrupt

    monkeypatch.setattr(hand_run_module, "HandRun", Stopped)
    return configs


def track(recording: Path, tmp_path: Path, *options: str) -> int:
    output = tmp_path / "r.mcap"
    return run(["hand", "run", str(recording), "-o", str(output), "--hand-side", "right", *FEW, *options])


def one_line(capsys: pytest.CaptureFixture[str]) -> str:
    (line,) = [line for line in capsys.readouterr().err.splitlines() if line.strip()]
    return line


@pytest.mark.parametrize("options", [(), ("--shape", "auto")], ids=["default", "auto"])
def test_a_shape_is_estimated_unless_it_is_told(
    recording: Path,
    tmp_path: Path,
    estimated: list[CalibrationOptions],
    capsys: pytest.CaptureFixture[str],
    options: tuple[str, ...],
) -> None:
    assert track(recording, tmp_path, "--start", "1", "--seed", "7", *options) in (0, 3)
    assert estimated == [CalibrationOptions("right", start=1)]
    said = capsys.readouterr().err.splitlines()
    assert "detecting side and size ..." in said
    assert any(line.startswith(f"{recording}: a right hand, 143 mm long") for line in said)
    used = json.loads(read_result(tmp_path / "r.mcap").run["configuration"])["hand"]
    assert used["coefficients"] == pytest.approx(SHAPE.coefficients) and used["scale"] == SHAPE.scale


@pytest.mark.parametrize(
    ("options", "shape"),
    [
        (("--shape", "average"), HandShape()),
        (("--scale", "0.9"), HandShape(0.9)),
        (("--shape", "average", "--scale", "0.9"), HandShape(0.9)),
        (("--shape", "auto", "--scale", "0.9"), HandShape(0.9)),
        (("--set", "init.shape=given"), HandShape()),
        (("--set", "hand.coefficients=[0.5]"), HandShape(coefficients=(0.5,))),
    ],
    ids=str,
)
def test_a_shape_that_is_told_is_tracked(
    recording: Path,
    tmp_path: Path,
    estimated: list[CalibrationOptions],
    used: list[HandConfig],
    options: tuple[str, ...],
    shape: HandShape,
) -> None:
    track(recording, tmp_path, *options)
    assert [config.hand.shape for config in used] == [shape] and not estimated


def test_a_file_is_a_shape(
    recording: Path,
    hand_file: Path,
    tmp_path: Path,
    estimated: list[CalibrationOptions],
    used: list[HandConfig],
) -> None:
    """Over what configurations say of the hand, and under what further options say."""
    other = tmp_path / "other.toml"
    other.write_text("[hand]\nscale = 1.2\n[filter]\nparticles = 17\n")
    track(recording, tmp_path, "--config", str(other), "--shape", str(hand_file))
    track(recording, tmp_path, "--shape", str(hand_file), "--scale", "0.7")
    assert [config.hand.scale for config in used] == [0.8, 0.7] and not estimated
    assert all(config.hand.coefficients == pytest.approx(SHAPE.coefficients) for config in used)


def test_a_folder_of_results_is_the_mean_of_their_shapes(
    recording: Path, tmp_path: Path, estimated: list[CalibrationOptions], used: list[HandConfig]
) -> None:
    """Of one person, who may show either hand."""
    for name, side, scale, coefficients in (("a", "right", 0.9, [1.0, 0.5]), ("b/c", "left", 1.0, [2.0])):
        hand = {"side": side, "scale": scale, "coefficients": coefficients}
        path = tmp_path / f"p/{name}.mcap"
        path.parent.mkdir(exist_ok=True)
        write_result(path, 1, run=RUN | {"configuration": json.dumps({"hand": hand})})
    track(recording, tmp_path, "--shape", str(tmp_path / "p"))
    (config,) = used
    assert not estimated and config.hand.side == "right"  # --hand-side of track
    assert config.hand.scale == round(float(np.sqrt(0.9)), 4)  # sizes multiply
    assert config.hand.coefficients[:2] == (1.5, 0.25) and not any(config.hand.coefficients[2:])


def test_a_result_is_a_shape(
    recording: Path, hand_file: Path, tmp_path: Path, estimated: list[CalibrationOptions]
) -> None:
    """To the last bit what the earlier run tracked; further options say otherwise."""
    hands = []
    first = str(tmp_path / "first" / "r.mcap")
    options = {
        "first": ("--shape", str(hand_file)),
        "second": ("--shape", first),
        "third": ("--shape", first, "--scale", "0.7"),
    }
    for name, given in options.items():
        (tmp_path / name).mkdir()
        assert track(recording, tmp_path / name, *given) in (0, 3)
        hands.append(json.loads(read_result(tmp_path / name / "r.mcap").run["configuration"])["hand"])
    assert hands[1] == hands[0] and not estimated
    assert hands[2] == {**hands[0], "scale": 0.7}


def test_a_recording_is_no_shape(recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert track(recording, tmp_path, "--shape", str(recording)) == 1
    assert str(recording) in one_line(capsys)


def test_another_shape_gives_other_joints(recording: Path, hand_file: Path, tmp_path: Path) -> None:
    spans = []
    for name, shape in (("average", "average"), ("file", str(hand_file))):
        (tmp_path / name).mkdir()
        start = ("--init", str(recording))
        assert track(recording, tmp_path / name, "--shape", shape, *start) in (0, 3)
        points = load_arrays(tmp_path / name / "r.mcap")["points"][0]
        spans.append(np.linalg.norm(points[9] - points[5]))
    assert spans[1] < 0.95 * spans[0]


@pytest.mark.parametrize(
    ("options", "said", "code"),
    [
        (("--start", "100"), "no frames to track", 2),
        (("--init", "none.toml"), "none.toml: no such start pose file", 2),
        (("--resume",), "no unfinished result to resume", 1),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else "",
)
def test_a_run_that_cannot_be_done_is_refused_before_a_shape_is_estimated(
    recording: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    estimated: list[CalibrationOptions],
    options: tuple[str, ...],
    said: str,
    code: int,
) -> None:
    """Which takes a minute, for nothing."""
    arguments = ["hand", "run", str(recording), "-o", str(tmp_path / "r.mcap"), *options]
    assert run(arguments) == code
    assert said in one_line(capsys) and not estimated


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--shape", "none.toml"), "none.toml: no such configuration"),
        (("--shape", "FOLDER"), "folder has no results"),
        (("--shape", "FILE", "--hand-mesh", "MESH"), "no hand.coefficients together with hand.mesh"),
        (
            ("--hand-mesh", "MESH", "--set", "hand.coefficients=[1.0]"),
            "no hand.coefficients together with hand.mesh",
        ),
        (
            ("--set", "hand.coefficients=[9.0]"),
            "'hand.coefficients.0' cannot be used, found 9.0, expected 5 or",
        ),
        (("--set", "init.shape=small"), "'init.shape' cannot be used"),
        (("--set", "init.calibrate=true"), "unknown configuration key 'init.calibrate'"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else "",
)
def test_what_cannot_be_meant_is_refused_in_a_line(
    recording: Path,
    hand_file: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    options: tuple[str, ...],
    said: str,
) -> None:
    mesh = write_hand(tmp_path / "right.glb", REST_HAND, REST) if "MESH" in options else None
    places = {"FILE": str(hand_file), "FOLDER": str(tmp_path), "MESH": str(mesh)}
    before = set(tmp_path.iterdir())
    assert track(recording, tmp_path, *(places.get(option, option) for option in options)) == 2
    assert said in one_line(capsys)
    assert set(tmp_path.iterdir()) == before
