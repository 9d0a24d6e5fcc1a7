"""The studies: what their runner keeps and makes again, statistics, commands, and one small study."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from posetrack_cli.cli.main import cli
from posetrack_cli.errors import PosetrackError, UsageError
from posetrack_cli.results import load_arrays
from research import hand, mono, runner
from research.hand_strangers import people_of
from research.report import Report, adjusted, pairs_of
from research.runner import FILE, TOOL, Files, Job, Order, Step, run_jobs, run_steps
from research.study import FIRST_SEED, NAMES, Part, study_of
from support.heads import heads_folder

# The runner

DRAWN = Step("recordings/a.mcap", ("head", "synth", "--frames", "3"))
TRACKED = Step("runs/a.mcap", ("head", "stereo", f"{FILE}recordings/a.mcap", "--passes", "2"))
BUILT = Step("models/f.npz", ("head", "build-model", f"{FILE}runs/a.mcap"))
JOBS = (Job("a", (DRAWN, TRACKED)), Job("b", (BUILT,)))


class Commands:
    """Notes commands and writes their output, but fails where ``fails`` is among the arguments."""

    def __init__(self) -> None:
        self.done: list[tuple[str, ...]] = []
        self.fails = "nothing"

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
    """Commands that are noted, in this process."""
    made = Commands()

    def run_here(out: Path, name: str, orders: list[Order]) -> str:
        failed = run_steps(out, orders)
        return f"{name}: {', '.join(failed)}" if failed else ""

    monkeypatch.setattr(runner, "command", made)
    monkeypatch.setattr(runner, "_run_process", run_here)
    of_code(monkeypatch, "a tracker", "faces")
    return made


def of_code(monkeypatch: pytest.MonkeyPatch, tracker: str, faces: str) -> None:
    monkeypatch.setattr(runner, "_code_of", lambda step: faces if step.arguments[1] == "synth" else tracker)


def run(out: Path, jobs: Iterable[Job] = JOBS) -> list[str]:
    return run_jobs(Files(out, jobs), 1, "test")


def test_every_file_is_made_once_from_its_files(tmp_path: Path, commands: Commands) -> None:
    assert run(tmp_path, [*reversed(JOBS), JOBS[0]]) == []
    recording, result = (str(tmp_path / name) for name in ("recordings/a.mcap", "runs/a.mcap"))
    assert commands.done[0] == ("head", "synth", "--frames", "3", "-o", recording, "--overwrite")
    assert commands.done[1] == ("head", "stereo", recording, "--passes", "2", "-o", result, "--overwrite")
    assert commands.names == ["synth", "stereo", "build-model"]
    assert run(tmp_path) == [] and commands.names == []
    assert Files(tmp_path, JOBS).made(BUILT.output) == tmp_path / BUILT.output


def test_other_code_and_other_arguments_make_again_what_depends_on_them(
    tmp_path: Path, commands: Commands, monkeypatch: pytest.MonkeyPatch
) -> None:
    run(tmp_path)
    assert commands.names == ["synth", "stereo", "build-model"]
    of_code(monkeypatch, "another tracker", "faces")
    run(tmp_path)
    assert commands.names == ["stereo", "build-model"]
    of_code(monkeypatch, "another tracker", "other faces")
    run(tmp_path)
    assert commands.names == ["synth", "stereo", "build-model"]
    once = TRACKED._replace(arguments=(*TRACKED.arguments[:3], "--passes", "1"))
    other = [Job("a", (DRAWN, once)), JOBS[1]]
    assert Files(tmp_path, other).made(BUILT.output) is None
    run(tmp_path, other)
    assert commands.names == ["stereo", "build-model"]


def test_a_failure_prevents_only_what_needs_it_and_an_old_file_is_not_taken_for_the_new_one(
    tmp_path: Path, commands: Commands, monkeypatch: pytest.MonkeyPatch
) -> None:
    run(tmp_path)
    of_code(monkeypatch, "another tracker", "faces")
    commands.fails = "stereo"
    other = Step("runs/b.mcap", ("head", "mono", f"{FILE}recordings/a.mcap"))
    jobs = [Job("a", (DRAWN, TRACKED, other)), JOBS[1]]
    assert run(tmp_path, jobs) == ["a: runs/a.mcap", "b: models/f.npz"]
    files = Files(tmp_path, jobs)
    assert files.made(other.output) and not files.made(TRACKED.output) and not files.made(BUILT.output)


def test_scratch_is_made_where_something_needs_it_and_deleted(tmp_path: Path, commands: Commands) -> None:
    drawn = DRAWN._replace(scratch=True)
    run(tmp_path, [Job("a", (drawn, TRACKED))])
    assert commands.names[1:4] == ["synth", "stereo"][1:] and not (tmp_path / DRAWN.output).exists()
    run(tmp_path, [Job("a", (drawn, TRACKED))])
    assert commands.names == []
    again = Step("runs/c.mcap", ("head", "mono", f"{FILE}recordings/a.mcap"))
    run(tmp_path, [Job("a", (drawn, TRACKED, again))])
    assert commands.names == ["synth", "mono"] and list((tmp_path / "recordings").iterdir()) == []


# Statistics

ROWS = {str(k): {"error": 10.0 + k} for k in range(8)}


def better(gain: float) -> dict[str, dict[str, float]]:
    return {key: {"error": row["error"] - gain} for key, row in ROWS.items()}


def test_p_values_are_wilcoxons_adjusted_as_by_benjamini_and_hochberg() -> None:
    """Of 2^8 equally likely signs two are as extreme; p_(i) n / i, from the largest down never growing."""
    report, gains = Report(), (2.0, 0.0, -3.0)
    pairs = {(str(gain),): pairs_of(ROWS, better(gain), "error") for gain in gains}
    said = report.pairs("part", ("gain",), {**pairs, ("none",): np.zeros((0, 2))})
    assert [one.p_value for one in said[:3]] == [2.0**-7, 1.0, 2.0**-7]
    np.testing.assert_allclose(
        adjusted([2.0**-7, 1.0, 2.0**-7, np.nan])[:3], [1.5 * 2.0**-7, 1.0, 1.5 * 2.0**-7]
    )
    # 10..17 has mean 13.5 and sample variance (8^2 - 1) / 12 * 8 / 7 = 6
    row = "| 2.0 | 8 | 13.50 ± 2.45 | 11.50 ± 2.45 | -2.00 [-2.00, -2.00] | 0.0078 | 0.012 | 8 of 8 |"
    assert row in report.lines and report.notes["part"]["2.0"]["difference"] == -2.0


def test_targets_are_judged_from_both_sides() -> None:
    report = Report()
    for value in (0.7, 0.9, 0.98, None, np.nan):
        report.judge("inside", value, least=0.8, most=0.97, percent=True)
    said = [said for _, _, _, said in report.targets]
    assert said == ["**missed**", "reached", "**missed**", "not measured", "not measured"]


# What the studies run


def commands_of(jobs: Iterable[Job]) -> set[tuple[str, ...]]:
    return {step.arguments for job in jobs for step in job.steps if step.arguments[0] != TOOL}


def every_study(tmp_path: Path) -> list[tuple[Any, Any]]:
    heads, people = heads_folder(tmp_path, "person-c", "person-d"), people_of("800,803", final=False)
    (tmp_path / "clip.mp4").touch()
    options = {
        "hand": {"seeds": 1, "kinect": tmp_path},
        "hand-accuracy": {"seeds": 1, "kinect": tmp_path},
        "hand-strangers": {"tool": Path("tool.py"), "people": people, "frames": 30},
        "heads-strangers": {"heads": heads, "left_out": tmp_path},
        "stereo": {"heads": heads},
        "mono": {"heads": heads, "clips": tmp_path},
    }
    return [(study := study_of(name), study.options(tmp_path, **options[name])) for name in NAMES]


def every_job(tmp_path: Path) -> list[Job]:
    return [job for study, of in every_study(tmp_path) for part in study.parts for job in part.jobs(of)]


def test_every_step_is_a_command_that_is_understood_and_draws_what_is_kept_for_reports(
    tmp_path: Path,
) -> None:
    for arguments in commands_of(every_job(tmp_path)):
        command, names = cli, list(arguments)
        while hasattr(command, "commands"):
            command = command.commands[names.pop(0)]  # type: ignore[union-attr]
        given = [*(one.removeprefix(FILE) for one in names), "-o", "out.mcap", "--overwrite"]
        context = command.make_context("x", given)
        assert arguments[1] != "synth" or context.params["seed"] >= FIRST_SEED


def test_what_was_not_measured_is_said_to_be_so(tmp_path: Path) -> None:
    report = Report()
    for study, options in every_study(tmp_path):
        for part in study.parts:
            if part.name != "time":  # which is measured while it is told
                part.write(options, Files(tmp_path, []), report)
    assert {said for _, _, _, said in report.targets} == {"not measured"}
    assert "nan" not in "\n".join(report.lines)


def test_the_experiments_are_the_thesiss(tmp_path: Path) -> None:
    """A: the person is among the 11 of the model; B: the other 10; C: as A, adjusted at the start only."""
    options = mono.Options(tmp_path)
    steps = {step.output: step for job in mono.population_jobs(options) for step in job.steps}
    models, adjusted_when = {}, []
    for name in "ABC":
        arguments = steps[f"runs/test-{FIRST_SEED}-1800-{name}.mcap"].arguments
        models[name] = set(steps[arguments[arguments.index("--face-model") + 1].removeprefix(FILE)].files)
        adjusted_when.append(arguments[arguments.index("--adjust") + 1])
    own = {name for name in models["A"] if f"-{FIRST_SEED}-" in name}
    assert (len(models["A"]), models["B"], models["C"]) == (11, models["A"] - own, models["A"])
    assert adjusted_when == ["always", "always", "start"] and len(own) == 1


def test_people_are_named_once_each_and_those_for_final_measurements_are_refused() -> None:
    people = people_of("803, 800-802,801", final=False)
    assert [person.number for person in people] == [800, 801, 802, 803]
    assert " ".join(people[1].drawing(7)) == "--person 801 --motion 801 --frames 7 --left --back"
    with pytest.raises(UsageError, match="final measurements"):
        people_of("899-900", final=False)
    for text in ("", "800-", "a", "810-800", "-3", "800,,801", "0-5000"):
        with pytest.raises(UsageError, match="invalid --people"):
            people_of(text, final=False)


@pytest.mark.parametrize("given", [["--people", "900"], ["--tool", "none.py"]])
def test_what_cannot_be_measured_is_refused_in_one_line(tmp_path: Path, given: list[str]) -> None:
    (tmp_path / "foreign_hand.py").touch()
    tool = [] if "--tool" in given else ["--tool", str(tmp_path / "foreign_hand.py")]
    asked = [*given, *tool, "-o", str(tmp_path / "out")]
    said = CliRunner().invoke(study_of("hand-strangers").command(), asked)
    assert said.exit_code == 1 and said.output.count("\n") == 1 and not (tmp_path / "out").exists()


@pytest.mark.parametrize("name", NAMES)
def test_quick_takes_what_is_given_and_little_of_the_rest(name: str, tmp_path: Path) -> None:
    study = study_of(name)
    assert CliRunner().invoke(study.command(), ["--help"]).exit_code == 0
    if not study.quick:
        return
    taken: list[Any] = []
    first = next(iter(study.quick))
    measured = replace(
        study, parts=(Part("a", lambda options: taken.append(options) or (), lambda *_: None),)
    )
    asked = ["-o", str(tmp_path), "--quick", f"--{first}", "3"]
    said = CliRunner().invoke(measured.command(), asked, catch_exceptions=False)
    assert said.exit_code == 0, said.output
    assert {key: getattr(taken[0], key) for key in study.quick} == {**study.quick, first: 3}


# One small study


def test_a_study_is_run_reported_and_continued(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hand, "CONDITIONS", (("A", 1.0),))
    monkeypatch.setattr(hand, "STUDIED", ("union",))
    for kind in ("pf", "rbpf"):
        monkeypatch.setitem(hand.ENTRANTS[f"{kind}-union"].changes, "filter.particles", 16)
    monkeypatch.setattr(hand, "QUESTIONS", {"PF against RBPF": [("pf-union", "rbpf-union")]})
    asked = ["-o", str(tmp_path), "--seeds", "1", "--frames", "2", "--jobs", "1", "--part", "study"]
    said = CliRunner().invoke(hand.STUDY.command(), asked, catch_exceptions=False)
    assert said.exit_code == 0 and f"written: {tmp_path / 'hand.md'}" in said.output
    results = {kind: tmp_path / f"runs/A-1x-{FIRST_SEED}-2-{kind}-union.mcap" for kind in ("pf", "rbpf")}
    means = []
    for path in results.values():
        found, truth = load_arrays(path), load_arrays(path, hand.TRUTH)
        means.append(float(np.linalg.norm(found["points"] - truth["points"], axis=2).mean()))
    text = (tmp_path / "hand.md").read_text()
    assert f"| A | 1 | pf-union | rbpf-union | 1 | {means[0]:.2f} | {means[1]:.2f} |" in text
    assert list((tmp_path / "recordings").iterdir()) == []
    written = {path: path.stat().st_mtime_ns for path in results.values()}
    results["rbpf"].unlink()  # as if it had been interrupted
    assert CliRunner().invoke(hand.STUDY.command(), asked, catch_exceptions=False).exit_code == 0
    assert results["pf"].stat().st_mtime_ns == written[results["pf"]] and results["rbpf"].exists()
    assert (tmp_path / "hand.md").read_text() == text
