"""Files that commands make of each other: what is made, kept, made again, and what a failure keeps away."""

from __future__ import annotations

from pathlib import Path

import pytest

from posetrack_cli.errors import PosetrackError
from reproduction import steps
from reproduction.steps import Chain, Step, is_current, run_chain, run_chains

DRAWN = Step("recordings/a.mcap", ("head", "synth", "--frames", "3"))
TRACKED = Step("runs/a.mcap", ("head", "stereo", "@recordings/a.mcap", "--passes", "2"))
BUILT = Step("models/f.npz", ("head", "build-model", "@runs/a.mcap"))
CHAIN = Chain("a", 0, (DRAWN, TRACKED, BUILT))


class Commands:
    """Notes commands and writes their output, but fails where ``fails`` is among the arguments."""

    def __init__(self, fails: str = "nothing") -> None:
        self.done: list[tuple[str, ...]] = []
        self.fails = fails

    def __call__(self, *arguments: str) -> None:
        self.done.append(arguments)
        if self.fails in arguments:
            raise PosetrackError("failed")
        Path(arguments[arguments.index("-o") + 1]).write_text("made")

    @property
    def names(self) -> list[str]:
        """What was run since the last time."""
        done, self.done = self.done, []
        return [arguments[1] for arguments in done]


@pytest.fixture
def commands(monkeypatch: pytest.MonkeyPatch) -> Commands:
    made = Commands()
    monkeypatch.setattr(steps, "command", made)
    monkeypatch.setattr(steps, "source_digest", lambda: "a tracker")
    monkeypatch.setattr(steps, "drawing_digest", lambda: "faces")
    return made


def test_every_step_is_run_once_with_its_files(tmp_path: Path, commands: Commands) -> None:
    run_chain(CHAIN, tmp_path)
    recording, result = str(tmp_path / "recordings/a.mcap"), str(tmp_path / "runs/a.mcap")
    assert commands.done[0] == ("head", "synth", "--frames", "3", "-o", recording, "--overwrite")
    assert commands.done[1] == ("head", "stereo", recording, "--passes", "2", "-o", result, "--overwrite")
    assert commands.done[2][:3] == ("head", "build-model", result)
    assert commands.names == ["synth", "stereo", "build-model"]
    run_chain(CHAIN, tmp_path)
    assert commands.names == [] and all(is_current(step, tmp_path) for step in CHAIN.steps)


def test_other_code_makes_again_what_depends_on_it(
    tmp_path: Path, commands: Commands, monkeypatch: pytest.MonkeyPatch
) -> None:
    run_chain(CHAIN, tmp_path)
    monkeypatch.setattr(steps, "source_digest", lambda: "another tracker")
    run_chain(CHAIN, tmp_path)
    monkeypatch.setattr(steps, "drawing_digest", lambda: "other faces")
    run_chain(CHAIN, tmp_path)
    assert commands.names[3:] == ["stereo", "build-model", "synth", "stereo", "build-model"]


def test_other_arguments_make_again_what_depends_on_them(tmp_path: Path, commands: Commands) -> None:
    run_chain(CHAIN, tmp_path)
    once = Step(TRACKED.output, (*TRACKED.arguments[:3], "--passes", "1"))
    run_chain(Chain("a", 0, (DRAWN, once)), tmp_path)
    assert commands.names[3:] == ["stereo"]
    assert not is_current(BUILT, tmp_path)  # its input is another one now


def test_a_failure_keeps_away_only_what_needs_it(tmp_path: Path, commands: Commands) -> None:
    commands.fails = "stereo"
    other = Step("runs/b.mcap", ("head", "mono", "@recordings/a.mcap"))
    with pytest.raises(PosetrackError, match=r"a: failed: runs/a.mcap, models/f.npz$"):
        run_chain(Chain("a", 0, (*CHAIN.steps, other)), tmp_path)
    assert commands.names == ["synth", "stereo", "mono"]
    assert is_current(DRAWN, tmp_path) and is_current(other, tmp_path) and not is_current(BUILT, tmp_path)


def test_an_output_that_could_not_be_made_again_is_not_taken_for_the_new_one(
    tmp_path: Path, commands: Commands, monkeypatch: pytest.MonkeyPatch
) -> None:
    run_chain(CHAIN, tmp_path)
    monkeypatch.setattr(steps, "source_digest", lambda: "another tracker")
    commands.fails = "stereo"
    with pytest.raises(PosetrackError):
        run_chain(CHAIN, tmp_path)
    monkeypatch.setattr(steps, "source_digest", lambda: "a tracker")
    assert not is_current(TRACKED, tmp_path)


def test_chains_are_run_stage_by_stage_and_none_twice(
    tmp_path: Path, commands: Commands, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[tuple[str, list[str]]] = []

    def run_modules(given: dict[str, list[str]], jobs: int, title: str) -> list[str]:
        asked.append((title, list(given)))
        for _, text, out in given.values():
            run_chain(Chain.of_text(text), Path(out))
        return ["b: it failed"] if "b" in given else []

    monkeypatch.setattr(steps, "run_modules", run_modules)
    drawn, built = Chain("a", 0, (DRAWN, TRACKED)), Chain("b", 1, (BUILT,))
    assert run_chains([built, drawn, drawn], tmp_path, 2) == ["b: it failed"]
    assert asked == [("stage 1", ["a"]), ("stage 2", ["b"])]
    asked.clear()
    assert run_chains([built, drawn], tmp_path, 2) == [] and asked == []
