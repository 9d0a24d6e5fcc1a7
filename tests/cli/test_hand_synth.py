from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner

from posetrack_cli.cli.hand_synth import SWITCHES, hand_synth, synth_options
from posetrack_cli.errors import PosetrackError, UsageError
from posetrack_cli.hand.synthesis.options import SWITCH_NAMES, Switches


def invoke(*arguments: str) -> str:
    result = CliRunner().invoke(hand_synth, list(arguments), catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.stdout


def test_it_writes_a_recording_and_says_so(tmp_path: Path) -> None:
    out = tmp_path / "a.mcap"
    line = invoke("-o", str(out), "--motion", "A", "--frames", "3")
    assert line.startswith(f"{out}: 3 frames, 0 dropped, 0.067 s long, made in ")
    assert [path.name for path in tmp_path.iterdir()] == ["a.mcap"]


def test_every_switch_has_an_option_and_every_option_is_meant() -> None:
    assert tuple(name for name, _ in SWITCHES) == SWITCH_NAMES
    off = dict.fromkeys(SWITCH_NAMES)
    assert synth_options({"motion": "C", **off}).switches == Switches.all_on()
    assert synth_options({"motion": "A", **off}).switches == Switches()
    for name in SWITCH_NAMES:
        assert getattr(synth_options({"motion": "A", **off, name: True}).switches, name)
        assert not getattr(synth_options({"motion": "C", **off, name: False}).switches, name)


@pytest.mark.parametrize(
    ("option", "value"),
    [("--frames", "0"), ("--speed", "-1"), ("--fps", "0"), ("--scale", "0"), ("--seed", "-1")],
)
def test_bad_values_are_wrong_usage_and_write_nothing(tmp_path: Path, option: str, value: str) -> None:
    with pytest.raises(UsageError, match=f"{option} cannot be used"):
        invoke("-o", str(tmp_path / "a.mcap"), "--motion", "C", option, value)
    assert list(tmp_path.iterdir()) == []


def test_an_unknown_motion_is_wrong_usage(tmp_path: Path) -> None:
    result = CliRunner().invoke(hand_synth, ["-o", str(tmp_path / "a.mcap"), "--motion", "D"])
    assert result.exit_code == 2


def test_unwritable_output_is_an_error_of_ours(tmp_path: Path) -> None:
    with pytest.raises(PosetrackError, match="cannot be written"):
        invoke("-o", str(tmp_path / "no" / "a.mcap"), "--motion", "A", "--frames", "1")


def test_overwrite_replaces(tmp_path: Path) -> None:
    out = tmp_path / "a.mcap"
    arguments = ("-o", str(out), "--motion", "a", "--frames", "1")
    invoke(*arguments)
    with pytest.raises(UsageError, match="exists already"):
        invoke(*arguments)
    invoke(*arguments, "--overwrite")
