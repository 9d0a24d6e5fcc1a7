from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner

from posetrack_cli.cli.synth import head_synth, head_synth_options
from posetrack_cli.errors import UsageError
from posetrack_cli.synthesis.head.options import HeadSynthOptions

SMALL = ("--frames", "2", "--image-size", "96x64")


def invoke(*arguments: str) -> str:
    result = CliRunner().invoke(head_synth, list(arguments), catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.stdout


def test_it_writes_a_file_or_a_folder_and_says_so(tmp_path: Path) -> None:
    line = invoke("-o", str(tmp_path / "a.mcap"), *SMALL)
    assert line.startswith(f"{tmp_path / 'a.mcap'}: 2 frames of 2 cameras, 0 images missing, 0.033 s long")
    line = invoke("-o", str(tmp_path / "b"), *SMALL, "--camera-count", "1", "--image-format", "png")
    assert line.startswith(f"{tmp_path / 'b'}: 2 frames of 1 camera, ")
    assert sorted(path.name for path in (tmp_path / "b" / "camera").iterdir()) == ["000000.png", "000001.png"]


def test_defaults_of_command_and_library_are_the_same() -> None:
    values = {
        parameter.name: parameter.get_default(head_synth.make_context("synth", ["-o", "a.mcap"]))
        for parameter in head_synth.params
        if parameter.name not in ("output", "image_format", "overwrite", "verbose", "quiet")
    }
    assert head_synth_options(values) == HeadSynthOptions()


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("--frames", "0"),
        ("--fps", "0"),
        ("--speed", "-1"),
        ("--noise-factor", "-1"),
        ("--identity", "-1"),
        ("--camera-count", "5"),
        ("--distance-mm", "10"),
        ("--baseline-mm", "0"),
        ("--image-size", "10x10"),
        ("--image-size", "640"),
    ],
)
def test_bad_values_are_wrong_usage_and_write_nothing(tmp_path: Path, option: str, value: str) -> None:
    with pytest.raises(UsageError, match=f"invalid {option}"):
        invoke("-o", str(tmp_path / "a.mcap"), option, value)
    assert list(tmp_path.iterdir()) == []


def test_unknown_choices_are_wrong_usage(tmp_path: Path) -> None:
    for option in ("--motion", "--script", "--light", "--image-format"):
        result = CliRunner().invoke(head_synth, ["-o", str(tmp_path / "a.mcap"), option, "none"])
        assert result.exit_code == 2


def test_a_script_needs_expressions(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="invalid --script"):
        invoke("-o", str(tmp_path / "a.mcap"), "--no-expressions", "--script", "two-motions")
