"""Several heads at once: two rendered people who cross, and the rules by which tracks exclude each other."""

from __future__ import annotations

import filecmp
from pathlib import Path

import numpy as np
import pytest

from posetrack_cli.api import track_head
from posetrack_cli.cli.main import run
from posetrack_cli.configuration import load_settings
from posetrack_cli.evaluation.measuring.evaluate import EvalOptions, evaluate
from posetrack_cli.evaluation.measuring.evaluation import Statistics
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.head.config import HeadMonoConfig, HeadStereoConfig
from posetrack_cli.head.run import HeadRunOptions
from posetrack_cli.head.runs import make_heads_run, make_stereo_run
from posetrack_cli.head.tracker.several import HeadsState, HeadsTracker, Member, people_of
from posetrack_cli.mcap.stream import McapFile
from posetrack_cli.outputs import part_path
from posetrack_cli.recording.opening import open_recording
from posetrack_cli.results import read_result
from posetrack_cli.results.columns import floats
from posetrack_cli.synthesis.head.options import HeadSynthOptions
from posetrack_cli.tracking.state_codec import Value
from support.two_people import Walker, make_recording

FPS, FRAMES = 15.0, 24
CAMERA = Camera(400, 300, 350.0, 350.0, 199.5, 149.5)
SETTINGS = {"particles.count": 100, "adjustment.views": 6, "skin.use": False}
CONFIG = load_settings(HeadMonoConfig, [], SETTINGS)
STEREO_SETTINGS = {"particles.count": 100, "run.passes": 2}
STEREO_CONFIG = load_settings(HeadStereoConfig, [], STEREO_SETTINGS)
HIDDEN = range(10, 14)
"""Frames in which the head behind is covered by more than half."""


def shown(cameras: int, frames: int) -> HeadSynthOptions:
    """Small images of calm faces."""
    return HeadSynthOptions(
        cameras=cameras,
        frames=frames,
        fps=FPS,
        width=400,
        height=300,
        expressions=False,
        motion="slight",
        light="steady",
    )


@pytest.fixture(scope="module")
def crossing(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two people who pass each other, 860 and 660 mm away."""
    behind, before = Walker(3, (-190, 860), (190, 860), 1), Walker(7, (160, 660), (-160, 660), 2)
    return make_recording(tmp_path_factory.mktemp("two") / "crossing", [behind, before], shown(1, FRAMES))


def tracked(recording: Path, output: Path, *, stop_after: int | None = None, resume: bool = False) -> None:
    """Run over the recording; stop after this many frames of both passes."""
    source, done = open_recording(recording, "grey", fps=FPS), [0]

    def stopped() -> bool:
        done[0] += 1
        return done[0] == stop_after

    options = HeadRunOptions(output, smooth=True, resume=resume)
    if len(source.cameras) > 1:
        run = make_stereo_run(source, STEREO_CONFIG, options, lambda estimate: None, all_faces=True)
    else:
        run = make_heads_run(source, CONFIG, options, lambda estimate: None)
    run.track(lambda estimate: None, stopped)


@pytest.fixture(scope="module")
def result(crossing: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("result") / "two.mcap"
    source = open_recording(crossing, "grey", fps=FPS)
    tracking = track_head(source, faces="all", settings=SETTINGS, output=path, smooth=True)
    counts = {len(tracking.current) for _ in tracking}
    assert counts == {2} and tracking.subject.label == "1"
    return path


def test_identities_survive_a_crossing(crossing: Path, result: Path) -> None:
    assert read_result(result).labels == ("1", "2")
    for label in "12":
        found = evaluate(result, EvalOptions(truth=crossing / "truth.mcap", align="similarity", label=label))
        assert found.metrics["identity_switches"] == found.metrics["false_tracks"] == 0
        assert found.metrics["missed_tracks"] == 0
        turned = found.metrics["rotation_deg"]
        assert isinstance(turned, Statistics)
        assert turned.median < 3.0  # right, by the definition of a right frame
        lost = read_result(result).of(label).to_numpy()["status"] == "lost"
        assert lost.mean() < 0.5
        assert set(np.flatnonzero(lost)) <= {*range(4), *range(7, 19)}  # not found yet, or partly hidden


def test_a_hidden_head_is_lost_and_found_again(result: Path) -> None:
    status = {label: read_result(result).of(label).to_numpy()["status"] for label in "12"}
    behind = min(
        status, key=lambda label: np.count_nonzero(status[label][HIDDEN.start : HIDDEN.stop] != "lost")
    )
    assert (status[behind][list(HIDDEN)] == "lost").all()
    assert (status[behind][-5:] == "tracking").all()


def test_every_track_has_a_smoothed_one_and_shares_topics(result: Path) -> None:
    topics = {channel.topic for _, channel in McapFile(result).channels()}
    assert {"/head/1/estimate", "/head/2/odometry", "/smoothed/head/2/estimate", "/tf"} <= topics
    assert "/head/1/joint_states" not in topics
    for part in read_result(result).parts:
        assert len(part.to_numpy("smoothed")["stamp_ns"]) == FRAMES


def test_an_interrupted_run_continues_to_the_same_bytes(crossing: Path, result: Path, tmp_path: Path) -> None:
    path = tmp_path / result.name
    tracked(crossing, path, stop_after=FRAMES + 13)  # within the second pass
    assert read_result(part_path(path)).labels == ("1", "2")
    assert part_path(path).exists()
    tracked(crossing, path, resume=True)
    assert filecmp.cmp(path, result, shallow=False)


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two people next to each other before two cameras, 760 and 700 mm away."""
    right, left = Walker(3, (-130, 760), (-120, 760), 1), Walker(7, (110, 700), (110, 690), 2)
    return make_recording(tmp_path_factory.mktemp("two") / "pair", [right, left], shown(2, 12))


def test_two_heads_before_two_cameras(pair: Path, tmp_path: Path) -> None:
    path, again = tmp_path / "pair.mcap", tmp_path / "again" / "pair.mcap"
    source = open_recording(pair, "grey", fps=FPS)
    tracking = track_head(source, faces="all", settings=STEREO_SETTINGS, output=path, smooth=True)
    assert {len(tracking.current) for _ in tracking} == {2}
    for label in "12":
        found = evaluate(path, EvalOptions(truth=pair / "truth.mcap", align="rigid", label=label))
        assert found.metrics["identity_switches"] == found.metrics["false_tracks"] == 0
        turned, placed = found.metrics["rotation_deg"], found.metrics["position_mm"]
        assert isinstance(turned, Statistics) and isinstance(placed, Statistics)
        # the wrong person's points are 200 mm off; a pixel is 1.2 mm wide
        assert turned.max < 1.0 and placed.max < 1.2
    again.parent.mkdir()
    tracked(pair, again, stop_after=12 + 7)  # within the second pass
    assert part_path(again).exists()
    tracked(pair, again, resume=True)
    assert filecmp.cmp(path, again, shallow=False)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--passes", "1"), "all faces require two passes"),
        (("--face", "2"), "--face and --faces are mutually exclusive"),
        (("--interpupillary-mm", "63"), "--interpupillary-mm applies to one face"),
    ],
)
def test_options_of_one_face_are_refused(
    crossing: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    arguments: tuple[str, ...],
    message: str,
) -> None:
    given = ("head", "mono", str(crossing), "--fps", "15", "--faces", "all", "-o", str(tmp_path / "r.mcap"))
    assert run([*given, *arguments]) == 2
    assert message in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


class Noting:
    """Stands for a head tracker that has learned something."""

    codec = Value(floats())

    def learned(self, state: str, *, for_second_pass: bool) -> dict[str, np.ndarray]:
        return {"who": np.array(state)}


def test_false_detections_are_no_people() -> None:
    heads = HeadsTracker((CAMERA,), [Noting()])  # type: ignore[list-item]
    members = tuple(Member(name, tracked) for name, tracked in (("ann", 200), ("wall", 9), ("bob", 30)))  # type: ignore[arg-type]
    learned = heads.learned(HeadsState(members, frames=200), for_second_pass=True)
    assert [str(one["who"]) for one, _ in people_of(learned)] == ["ann", "bob"]
    # in a short recording the longest track counts anyway
    short = heads.learned(HeadsState(members[1:2], frames=9))
    assert len(people_of(short)) == 1
    assert heads.learned(HeadsState()) == {}
