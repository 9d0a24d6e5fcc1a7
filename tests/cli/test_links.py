"""Symbolic links in the place of outputs: what they point to is never written to."""

from __future__ import annotations

from pathlib import Path

import pytest

from posetrack_cli.cli.main import run
from posetrack_cli.errors import EXIT_DONE, EXIT_USAGE
from support.hostile_files import write_depth, write_hand_result

PRECIOUS = b"precious"
DEPTH, RESULT = "depth", "result.mcap"
COMMANDS = [
    (["convert", DEPTH, "-o", "o.mcap"], ".part"),
    (["export", RESULT, "-o", "o.csv"], ".part"),
    (["export", RESULT, "-o", "o.npz"], ".part"),
    (["eval", RESULT, "--json", "o.json"], ".part"),
    (["eval", RESULT, "--csv", "o.csv"], ".part"),
    (["eval", RESULT, "--curve", "o.csv"], ".part"),
    (["eval", RESULT, "--html", "o.html"], ".part"),
    (["view", RESULT, "-o", "o.png"], ".part"),
    (["hand", "synth", "-o", "o.mcap"], ".part"),
    (["hand", "calibrate", DEPTH, "-o", "o.toml"], ".part"),
    (["head", "synth", "-o", "o.mcap"], ".part"),
    (["head", "synth", "-o", "o"], ".part"),
    (["head", "build-model", RESULT, "-o", "o.npz"], ".part"),
    (["head", "build-model", RESULT, "-o", "m.npz", "--picture", "o.png"], ".part"),
    (["calibrate", "stereo", DEPTH, "-o", "o.toml", "--squares", "4x3", "--square-mm", "9"], ".part"),
    *((["hand", "run", DEPTH, "-o", "o.mcap"], name) for name in (".part", ".part.state", ".part.frames")),
    (["hand", "run", DEPTH, "-o", "o.mcap", "--resume"], ".part.copy"),
    (["head", "mono", DEPTH, "-o", "o.mcap"], ".part.state.tmp"),
    (["head", "mono", DEPTH, "-o", "r.mcap", "--save-model", "o.npz"], ".part"),
]


def output_of(arguments: list[str]) -> str:
    (name,) = {word for word in arguments if Path(word).stem == "o" and word != "-o"}
    return name


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working folder, with inputs of every command."""
    monkeypatch.chdir(tmp_path)
    write_depth(tmp_path / DEPTH)
    write_hand_result(tmp_path / RESULT)
    (tmp_path / "victim").write_bytes(PRECIOUS)
    return tmp_path


@pytest.mark.parametrize(("arguments", "suffix"), COMMANDS, ids=lambda value: str(value))
def test_a_link_in_the_place_of_an_unfinished_file_is_refused(
    folder: Path, arguments: list[str], suffix: str, capsys: pytest.CaptureFixture[str]
) -> None:
    link = folder / f"{output_of(arguments)}{suffix}"
    link.symlink_to("victim")
    before = sorted(folder.rglob("*"))
    assert run([*arguments, "--overwrite"]) == EXIT_USAGE
    *remarks, told = capsys.readouterr().err.splitlines()
    assert all("read as intensities" in remark for remark in remarks)  # depth is given to a tracker of heads
    assert "is a symbolic link" in told and link.name in told
    assert sorted(folder.rglob("*")) == before
    assert (folder / "victim").read_bytes() == PRECIOUS


def test_a_link_in_the_place_of_an_unfinished_video_is_refused(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "o.part.mp4").symlink_to("victim")
    assert run(["view", RESULT, "-o", "o.mp4", "--overwrite"]) == EXIT_USAGE
    assert "o.part.mp4: is a symbolic link" in capsys.readouterr().err
    assert (folder / "victim").read_bytes() == PRECIOUS


@pytest.mark.parametrize("target", ["victim", "nothing"])
def test_an_output_that_is_a_link_is_replaced_itself(
    folder: Path, target: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """And only with --overwrite, as any file, even where it leads nowhere."""
    out = folder / "o.csv"
    out.symlink_to(target)
    assert run(["export", RESULT, "-o", "o.csv"]) == EXIT_USAGE
    assert "already exists" in capsys.readouterr().err
    assert run(["export", RESULT, "-o", "o.csv", "--overwrite"]) == EXIT_DONE
    assert not out.is_symlink() and out.read_bytes().startswith(b"frame_index,")
    assert (folder / "victim").read_bytes() == PRECIOUS and not (folder / "nothing").exists()


@pytest.mark.parametrize("target", ["/dev/null", DEPTH])
def test_a_link_to_what_is_no_file_is_refused(folder: Path, target: str) -> None:
    (folder / "o.csv").symlink_to(target)
    assert run(["export", RESULT, "-o", "o.csv", "--overwrite"]) == EXIT_USAGE
    assert (folder / "o.csv").is_symlink()


def test_a_folder_that_is_a_link_is_not_replaced(folder: Path) -> None:
    (folder / "o").symlink_to(DEPTH)
    assert run(["head", "synth", "-o", "o", "--overwrite"]) == EXIT_USAGE
    assert (folder / "o").is_symlink() and len(list((folder / DEPTH).iterdir())) == 4
