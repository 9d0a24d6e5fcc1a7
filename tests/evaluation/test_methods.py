"""Methods paragraphs: their command repeats the run, and they cite what the repository cites."""

from __future__ import annotations

import json
import shlex
from pathlib import Path

import numpy as np
import pytest
import yaml

import posetrack_cli as posetrack
from posetrack_cli.cli.main import run
from posetrack_cli.errors import EXIT_DONE, EXIT_USAGE
from posetrack_cli.evaluation.reports.methods import HAND, HEAD, methods, methods_of
from posetrack_cli.geometry.camera import Camera

ROOT = Path(__file__).parents[2]
# Settings by --config, --set and options, shape by scale, and frames
HAND_RUN = ["--hand-side", "left", "--scale", "1.05", "--filter", "pf", "--particles", "32", "--seed", "7"]
HAND_RUN += ["--config", "hand-fast", "--set", "observation.sigma_mm=9", "--start", "1", "--stride", "2"]


def command_of(text: str) -> list[str]:
    (line,) = (line for line in text.splitlines() if line.startswith("Command: posetrack "))
    return shlex.split(line)[2:]


@pytest.mark.parametrize(
    ("made", "tracked"),
    [
        (["hand", "synth", "--hand-side", "left", "--no-drops"], ["hand", "run", *HAND_RUN]),
        (
            ["head", "synth", "--camera-count", "1"],
            ["head", "mono", "--passes", "1", "--interpupillary-mm", "61"],
        ),
        (["head", "synth"], ["head", "mono", "--passes", "1", "--cameras", "right"]),
        (["head", "synth"], ["head", "stereo", "--particles", "50"]),
    ],
    ids=["hand", "mono", "one of two cameras", "stereo"],
)
def test_the_command_repeats_the_run(
    made: list[str], tracked: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run([*made, "--frames", "6", "--seed", "1", "-o", "in.mcap"]) == EXIT_DONE
    assert run([*tracked[:2], "in.mcap", *tracked[2:], "-o", "first.mcap"]) == EXIT_DONE
    text = methods(posetrack.read("first.mcap"))
    assert "in.mcap" in text and posetrack.read("first.mcap").run["version"] in text
    assert run(command_of(text)) == EXIT_DONE
    first, again = (posetrack.read(name).to_numpy() for name in ("first.mcap", "result.mcap"))
    for name, values in first.items():
        np.testing.assert_array_equal(values, again[name], err_msg=name)


def test_a_guessed_field_of_view_is_part_of_the_command() -> None:
    camera = json.dumps(Camera(640, 480, 320.0, 320.0, 319.5, 239.5).values())
    record = {"tracker": "head-mono", "configuration": '{"particles": {"count": 5}}', "camera": camera}
    record |= {
        "scale": "prior",
        "intrinsics": "guessed",
        "input.name": "a b.mp4",
        "version": "1",
        "seed": "0",
    }
    record |= {"sources": "s", "libraries": "l", "seed": "0"}
    text = methods_of(record, 1, 4)
    words = command_of(text)
    assert words[:3] == ["head", "mono", "a b.mp4"] and words[words.index("--fov") + 1] == "90"
    assert "To be added" not in text
    given = methods_of(record | {"landmarks.sha256": "0", "input.sha256": "1"}, 1, 4)
    assert "the options of the files that this run was given (landmarks)." in given
    assert "1 of 4 frames were tracked (25.0%); the others were reported as lost." in text
    for missing in ("configuration", "scale", "version", "camera"):
        with pytest.raises(ValueError, match=missing):
            methods_of({key: value for key, value in record.items() if key != missing}, 1, 4)


def test_info_prints_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recording, result = tmp_path / "in.mcap", tmp_path / "out.mcap"
    assert run(["hand", "synth", "--frames", "2", "-o", str(recording)]) == EXIT_DONE
    options = ["--hand-side", "right", "--shape", "average", "--particles", "8"]
    assert run(["hand", "run", str(recording), "-o", str(result), *options]) == EXIT_DONE
    capsys.readouterr()
    assert run(["info", str(result), "--methods"]) == EXIT_DONE
    assert capsys.readouterr().out == methods(posetrack.read(result)) + "\n"
    assert run(["info", str(result), "--methods", "--json", "-"]) == EXIT_USAGE


def test_the_citation_file_names_the_works_that_paragraphs_cite() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    titles = [one["title"] for one in citation["references"]]
    assert all(any(title in work for work in (*HAND, *HEAD)) for title in titles) and len(titles) == 2
    assert {"cff-version", "message", "title", "authors"} <= citation.keys()
