"""The study of scripts/reproduce stereo: what it runs, what it keeps, what it measures and says."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from posetrack_cli.cli.head_stereo import head_stereo
from posetrack_cli.cli.head_synth import head_synth
from posetrack_cli.configuration import find_configuration, load_settings
from posetrack_cli.errors import PosetrackError
from posetrack_cli.head.config import HeadStereoConfig
from posetrack_cli.head.face.points import MEAN_SHAPE, MOUTH, POINT_NAMES
from posetrack_cli.head.subject import StereoDiagnostics, head_subject
from posetrack_cli.head.tracker.confidence import NO_SIGNS
from posetrack_cli.mcap.sink import McapSink
from posetrack_cli.results import Estimate, ResultWriter, Status
from posetrack_cli.synthesis.recording import SYNTH_RECORD
from reproduction.heads import comparison, conditions, experiment, figures, people, tasks
from reproduction.heads.events import Events, events_of
from reproduction.heads.measuring import Course, Figures, Measured, course, figures_of, recovery_s
from reproduction.heads.options import Options
from reproduction.heads.tasks import ENTRANTS, Task
from reproduction.running import FIRST_SEED, Targets
from reproduction.stereo import PARTS
from support.heads import CAMERAS, FRAME_NS, heads_folder, judged, pose

ROUNDED_MM = 1e-4  # the truth's CSV has five digits after the point


class MadeUp(Measured):
    """Figures by task's name and entrant, given instead of measured."""

    def __init__(self, found: dict[tuple[str, str], Figures]) -> None:
        super().__init__(Path("nowhere"))
        self._made_up = found

    def figures(self, task: Task, entrant: str) -> Figures:
        return self._made_up.get((task.name, entrant), {})


def every_task(options: Options) -> list[Task]:
    return [task for part in PARTS for task in part.tasks(options)]


def test_tasks_have_names_of_their_own_and_persons_kept_for_the_report(tmp_path: Path) -> None:
    options = Options(tmp_path, heads_folder(tmp_path, "person-b", "person-a"))
    found = every_task(options)
    names = [task.name for task in found]
    assert names[:2] == ["person-a", "person-b"]
    assert len(names) == len(set(names)) == 2 + 3 * len(conditions.CONDITIONS) + 1
    for option in ("--identity", "--seed"):
        drawn = [task.synthetic for task in found if task.synthetic]
        assert {int(a[a.index(option) + 1]) for a in drawn} == set(range(FIRST_SEED, FIRST_SEED + 3))
    assert all(Task.of_text(task.text) == task for task in found)


def test_every_recording_and_entrant_is_a_command_that_is_understood(tmp_path: Path) -> None:
    for task in every_task(Options(tmp_path)):
        head_synth.make_context("synth", [*task.synthetic, "-o", "out.mcap"])
    for arguments in ENTRANTS.values():
        head_stereo.make_context("stereo", ["in.mcap", "-o", "out.mcap", *arguments])


def test_the_papers_configuration_is_the_printed_method() -> None:
    printed = load_settings(HeadStereoConfig, find_configuration("head-stereo-paper"), {})
    assert (printed.model.components, printed.model.rigid_frames, printed.particles.count) == (5, 120, 1000)
    assert (printed.particles.sigma, printed.particles.kappa) == (3.0, 0.5)
    assert (printed.particles.weighting, printed.particles.sampling) == ("printed", "printed")
    assert (printed.refinement.joint, printed.refinement.recalculation) == (False, "printed")
    assert (printed.refinement.rho, printed.refinement.epsilon) == (4.0, 2000.0)


def fake_command(done: list[tuple[str, ...]], fails: str = "nothing") -> object:
    """Notes commands and writes their output, but fails where ``fails`` is among the arguments."""

    def command(*arguments: str) -> None:
        done.append(arguments)
        if fails in arguments:
            raise PosetrackError("failed")
        Path(arguments[arguments.index("-o") + 1]).write_text("made")

    return command


def test_a_recording_is_drawn_once_and_tracked_once_by_each_entrant(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    done: list[tuple[str, ...]] = []
    monkeypatch.setattr(tasks, "command", fake_command(done))
    task = Task("a", ("--frames", "3"), entrants=("deformable", "rigid"))
    task.run(tmp_path)
    recording = str(tmp_path / "recordings" / "a.mcap")
    assert done[0] == ("head", "synth", "--frames", "3", "-o", recording, "--overwrite")
    assert [arguments[:3] for arguments in done[1:]] == [("head", "stereo", recording)] * 2
    assert "rigid" in done[2] and "rigid" not in done[1]
    done.clear()
    task.run(tmp_path)
    replace(task, entrants=("deformable", "paper")).run(tmp_path)
    assert [arguments[:2] for arguments in done] == [("head", "stereo")] and "head-stereo-paper" in done[0]


def test_what_has_changed_is_made_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    done: list[tuple[str, ...]] = []
    monkeypatch.setattr(tasks, "command", fake_command(done))
    task = Task("a", ("--frames", "3"), entrants=("rigid",))
    task.run(tmp_path)
    monkeypatch.setattr(tasks, "source_digest", lambda: "of another tracker")
    assert not task.is_current(tmp_path, "rigid")
    task.run(tmp_path)
    assert [arguments[1] for arguments in done] == ["synth", "stereo", "stereo"]  # the recording was kept
    monkeypatch.setattr(tasks, "drawing_digest", lambda: "of other faces")
    monkeypatch.setattr(tasks, "source_digest", lambda: "of all of that")
    task.run(tmp_path)
    assert [arguments[1] for arguments in done[3:]] == ["synth", "stereo"]


def test_a_folder_is_read_with_its_calibration(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    done: list[tuple[str, ...]] = []
    monkeypatch.setattr(tasks, "command", fake_command(done))
    (task,) = people.People().tasks(Options(tmp_path, heads_folder(tmp_path, "person-a")))
    replace(task, entrants=("rigid",)).run(tmp_path / "out")
    camera = tmp_path / "out" / "recordings" / "person-a.camera.toml"
    assert done[0][:7] == ("head", "stereo", task.folder, "--camera", str(camera), "--fps", "25")
    assert "cameras.right" in camera.read_text()


def test_an_entrant_that_fails_keeps_no_other_from_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tasks, "command", fake_command([], fails="rigid"))
    task = Task("a", ("--frames", "3"), entrants=("rigid", "deformable"))
    with pytest.raises(PosetrackError, match="a: failed: rigid"):
        task.run(tmp_path)
    assert task.is_current(tmp_path, "deformable") and not task.is_current(tmp_path, "rigid")


def true_shape(index: int) -> np.ndarray:
    """The mouth's corners come forward by 4 mm from frame 122 on, every second frame."""
    shape = np.array(MEAN_SHAPE)
    if index >= 122 and index % 2 == 0:
        shape[MOUTH, 2] += 4.0
    return shape


def estimate(index: int, status: Status, shift: float = 0.0) -> Estimate:
    """The truth, 1 mm beside it, with a model whose mouth is 7 mm low and does not move."""
    true = pose(index)
    points = np.array(MEAN_SHAPE)
    points[MOUTH, 1] -= 7.0
    tangent, learned = np.zeros(6), StereoDiagnostics(np.zeros(0), 0.25 if index > 3 else np.nan)
    moved = replace(true, position=true.position + np.array([shift, 0.0, 0.0]))
    return Estimate(
        frame_index=index,
        stamp_ns=index * FRAME_NS,
        status=status,
        confidence=0.5,
        position=moved.position,
        quaternion=moved.quaternion,
        shape=np.zeros(0),
        pose_rate=np.zeros(7),
        twist=tangent,
        pose_variance=tangent,
        twist_variance=tangent,
        points=moved.points(points),
        effective_sample_size=None,
        resampled=False,
        numbers=np.concatenate([learned.numbers(0), NO_SIGNS]),
        milliseconds=5.0,
    )


FRAMES, LOST = 130, 2


@pytest.fixture(scope="module")
def tracked(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A result and its truth: lost and far off in the first two frames, 20 mm off in frame 5, else right."""
    folder = tmp_path_factory.mktemp("tracked")
    result, truth = folder / "r.mcap", folder / "truth.csv"
    with ResultWriter(result, head_subject("left", 0), CAMERAS[0], {}, others=CAMERAS[1:]) as writer:
        for index in range(FRAMES):
            status = Status.LOST if index < LOST else Status.TRACKING
            shift = 300.0 if index < LOST else 20.0 if index == 5 else 0.0
            writer.write(estimate(index, status, shift))
        writer.finish({})
    names = [f"{name}_{axis}_mm" for name in POINT_NAMES for axis in "xyz"]
    with truth.open("w", newline="") as stream:
        writer_ = csv.writer(stream)
        writer_.writerow(["t_s", "x_mm", "y_mm", "z_mm", "qx", "qy", "qz", "qw", *names])
        for index in range(FRAMES):
            true = pose(index)
            row = [*true.position, *true.quaternion, *true_shape(index).ravel()]
            writer_.writerow([f"{index * FRAME_NS * 1e-9:.9f}", *(f"{value:.9f}" for value in row)])
    return result, truth


def test_errors_are_those_left_by_constant_offsets(tracked: tuple[Path, Path]) -> None:
    one = course(*tracked)
    assert one.tracked.tolist() == [False] * LOST + [True] * (FRAMES - LOST)
    # the rigid offset is a mean over tracked frames, of which one is 20 mm beside: 20 / 128 at most
    share = 20.0 / (FRAMES - LOST)
    right = np.delete(np.arange(LOST, FRAMES), 5 - LOST)
    assert one.position_mm[right].max() <= share + ROUNDED_MM
    assert one.position_mm[5] == pytest.approx(20.0, abs=2 * share)
    assert one.rotation_deg[LOST:].max() < 1e-3
    assert np.flatnonzero(one.wrong).tolist() == [0, 1, 5]
    moving = one.moved_mm[:, MOUTH].min(axis=1) > 3.0
    assert np.flatnonzero(moving).tolist() == [122, 124, 126, 128]
    assert np.flatnonzero(one.deforming).tolist() == [122, 124, 126, 128]
    # the corner's offset is a mean, too: of 128 frames 4 are 4 mm away
    mean = 4.0 * 4 / (FRAMES - LOST)
    np.testing.assert_allclose(one.points_mm[moving][:, MOUTH], 4.0 - mean, atol=2 * share)


def test_figures_are_of_tracked_frames_and_tell_deforming_from_neutral_ones(
    tracked: tuple[Path, Path],
) -> None:
    one = course(*tracked)
    found = figures_of(one, Events())
    assert found["tracked"] == pytest.approx(1.0 - LOST / FRAMES)
    assert (found["first"], found["wrong"], found["frames"], found["ms"]) == (LOST, 1.0, FRAMES, 5.0)
    assert found["x_mm"] == pytest.approx(one.pose[LOST:, 0].mean())
    assert found["deforming x_mm"] == pytest.approx(one.pose[[122, 124, 126, 128], 0].mean())
    assert found["still x_mm"] == pytest.approx(one.pose[[120, 121, 123, 125, 127, 129], 0].mean())
    assert found["mouth_mm"] == found["moving_mm"] == found["deforming moving_mm"]
    assert "still moving_mm" not in found and "recovery_s" not in found


def steady(tracked: np.ndarray, off_mm: np.ndarray) -> Course:
    """A course at ten frames a second."""
    count = len(tracked)
    return Course(
        seconds=0.1 * np.arange(count),
        tracked=tracked,
        pose=np.zeros((count, 6)),
        position_mm=off_mm,
        rotation_deg=np.zeros(count),
        points_mm=np.zeros((count, 10)),
        moved_mm=np.zeros((count, 10)),
        milliseconds=np.full(count, np.nan),
    )


def test_a_head_is_found_again_once_it_is_right_for_half_a_second() -> None:
    has_it, off = np.ones(40, dtype=np.bool_), np.zeros(40)
    assert recovery_s(steady(has_it, off), 1.0) == 0.0
    lost = has_it.copy()
    lost[8:13] = False
    assert recovery_s(steady(lost, off), 1.0) == pytest.approx(0.3)
    off[15] = 11.0  # right in frames 13 and 14 only, then steadily from 16 on
    assert recovery_s(steady(lost, off), 1.0) == pytest.approx(0.6)
    off[16:] = 11.0
    assert recovery_s(steady(lost, off), 1.0) == np.inf
    assert figures_of(steady(has_it, 0 * off), Events(turn=(1.0, 2.0)))["recovery_s"] == 0.0
    assert "recovery_s" not in figures_of(steady(has_it, 0 * off), Events(turn=(3.0, 9.0)))


def test_events_are_those_of_the_recordings_record(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    with McapSink(path) as sink:
        sink.metadata(SYNTH_RECORD, {"turn_s": "7.5 8.9", "occlusion_s": ""})
        sink.finish()
    assert events_of(path) == Events(turn=(7.5, 8.9))
    assert events_of(path).end_s == 8.9
    assert events_of(tmp_path) == Events() and Events().end_s is None


def test_targets_of_persons_are_judged(tmp_path: Path) -> None:
    options, targets = Options(tmp_path, heads_folder(tmp_path, "person-a")), Targets()
    good = dict.fromkeys(people.ONE_PASS, 0.2) | {"mouth_mm": 2.6, "tracked": 0.996, "first": 29.0}
    found = {
        ("person-a", "deformable"): good | {"frames": 600.0, "wrong": 0.0},
        ("person-a", "deformable-2"): good | {"frames": 600.0, "wrong": 0.0, "x_mm": 0.21},
    }
    text = "\n".join(people.People().lines(options, MadeUp(found), targets))
    said = judged(targets)
    assert said["person-a, one pass: x, mm"] == ("0.200", "reached")
    assert said["person-a, two passes: x, mm"] == ("0.210", "**missed**")
    assert said["person-a, one pass: moving corners of the mouth, mm"] == ("2.600", "**missed**")
    assert said["person-a: frames tracked"] == ("99.60%", "reached")
    assert said["person-a: first frame tracked"] == ("29", "reached")
    assert (
        "| deformable (default) | 0.20 | 0.20 | 0.20 | 0.20 | 0.20 | 0.20 | 2.60 | 99.6 % | 29 | 0 |" in text
    )


def test_models_are_compared_recording_by_recording(tmp_path: Path) -> None:
    options, targets = Options(tmp_path, conditions=("noise 2",)), Targets()
    found: dict[tuple[str, str], Figures] = {}
    for k, task in enumerate(conditions.tasks_of(options, "noise 2")):
        rigid = {"deforming pitch_deg": 2.0, "deforming moving_mm": 6.0, "still pitch_deg": 0.4}
        found[task.name, "rigid"] = rigid | {"still position_mm": 1.0}
        found[task.name, "deformable"] = {
            "deforming pitch_deg": 0.6 + k,  # .3, .8 and 1.3 of the rigid one's
            "deforming moving_mm": 2.0 + k,
            "still pitch_deg": 0.41,
            "still position_mm": 1.2,
        }
    part = comparison.Comparison((conditions.Conditions(),))
    text = "\n".join(part.lines(options, MadeUp(found), targets))
    said = judged(targets)
    lower = "lower than the rigid model's, recordings"
    assert said[f"deforming: pitch, deg: {lower}"] == ("2 of 3", "**missed**")
    assert said[f"deforming: moving points, mm: {lower}"] == ("3 of 3", "reached")
    assert said["deforming: pitch, deg: of the rigid model's, median"] == ("0.80", "**missed**")
    assert said["deforming: moving points, mm: of the rigid model's, median"] == ("0.50", "reached")
    assert said["neutral: pitch, deg: deformable of rigid, means"] == ("1.02", "reached")
    assert said["neutral: position, mm: deformable of rigid, means"] == ("1.20", "**missed**")
    assert said["mouth, mm: deformable-2 of deformable, means"][1] == "not measured"
    assert "| noise-2-201-300 | 2.00 → 0.60 | 6.00 → 2.00 | 0.40 → 0.41 | - | 1.00 → 1.20 |" in text


def test_recovery_and_wrong_frames_are_judged_over_all_persons(tmp_path: Path) -> None:
    options, targets = Options(tmp_path), Targets()
    found: dict[tuple[str, str], Figures] = {}
    for task in conditions.Conditions().tasks(options):
        found[task.name, "deformable"] = {"frames": 300.0, "wrong": 0.0, "first": 1.0}
    for k, task in enumerate(conditions.tasks_of(options, "occlusion")):
        found[task.name, "deformable"] = {"frames": 300.0, "wrong": float(k == 2), "recovery_s": 0.2 * k}
    for task in conditions.tasks_of(options, "sudden turn"):
        found[task.name, "deformable"] = {"frames": 300.0, "wrong": 0.0, "recovery_s": np.inf}
    text = "\n".join(conditions.Conditions().lines(options, MadeUp(found), targets))
    said = judged(targets)
    assert said["occlusion: found again, s, longest"] == ("0.40", "reached")
    assert said["sudden turn: found again, s, longest"] == ("inf", "**missed**")
    wrong = "wrong poses reported as tracking, all conditions"
    frames = 300 * 3 * len(conditions.CONDITIONS)
    assert said[f"deformable (default): {wrong}"] == (f"1 of {frames}", "**missed**")
    assert said[f"deformable, two passes: {wrong}"][1] == "not measured"
    assert "| occlusion | deformable (default) | 3 | 0.20 | 0.40 |" in text


def test_what_was_not_measured_is_said_to_be_so(tmp_path: Path) -> None:
    options, targets = Options(tmp_path), Targets()
    for part in PARTS:
        assert list(part.lines(options, MadeUp({}), targets))
    assert {said for _, _, _, said in targets.rows} == {"not measured"}


def test_the_experiments_parts_are_the_thesiss() -> None:
    spans = experiment.Spans.of(1800)
    assert np.flatnonzero(spans.deforming)[[0, -1]].tolist() == [120, 1199]  # frames 121 to 1200, from 1
    assert np.flatnonzero(spans.rigid)[[0, -1]].tolist() == [1200, 1799]


def test_pictures_show_the_greatest_deformations(tracked: tuple[Path, Path]) -> None:
    one = course(*tracked)
    moved = np.zeros_like(one.moved_mm)
    moved[[3, 40, 70], 4] = 5.0  # before the model deforms, within its first third, within its second
    rows = np.arange(FRAMES)
    spans = experiment.Spans((rows >= 30) & (rows < 120), rows >= 120)
    chosen = experiment.picture_frames(replace(one, moved_mm=moved), spans)
    assert chosen[:2] == [40, 70] and 90 <= chosen[2] < 120 <= chosen[3] < 130


def test_the_contribution_ratio_is_told(tracked: tuple[Path, Path]) -> None:
    ratio = experiment.contribution_ratio(tracked[0])
    assert np.isnan(ratio[:4]).all() and (ratio[4:] == 0.25).all()
    ratio[50] = 0.1
    (said, _) = experiment._contribution_lines(ratio)
    assert said == (
        "Ours: learning begins in frame 4; lowest 10% in frame 50; 25% in frame 129; 25% in the end."
    )


def test_figure_3_10_is_drawn(tracked: tuple[Path, Path], tmp_path: Path) -> None:
    from posetrack_cli.evaluation.evaluate import EvalOptions, evaluate

    evaluation = evaluate(tracked[0], EvalOptions(truth=tracked[1], align="rigid+points"))
    assert evaluation.truth is not None
    one = course(*tracked)
    tracks = {"truth": evaluation.truth, "rigid": evaluation.track, "deformable": evaluation.track}
    ratio = experiment.contribution_ratio(tracked[0])
    courses = {"rigid": one, "deformable": one}
    figures.poses_over_time(tmp_path / "f.png", tracks, courses, ratio, (120, 125))
    assert (tmp_path / "f.png").read_bytes().startswith(b"\x89PNG")
    np.testing.assert_allclose(figures.pose_columns(evaluation.truth)[:, 0], 2.0 * np.arange(FRAMES))
