"""The hand of a run record: what a result states leads to files beside it, and to those it was made with."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from posetrack_cli.errors import ResultError
from posetrack_cli.evaluation.reading.recording_of import anatomy_of, hand_of
from posetrack_cli.hand.model.anatomy import make_anatomy
from posetrack_cli.hand.model.hand import MESH_DIGEST
from posetrack_cli.hand.model.kinematics import joint_positions
from posetrack_cli.recording.identity import file_digest
from posetrack_cli.results.estimate import Subject
from posetrack_cli.results.reader import Result
from support.glb import write_hand


def result_of(run: dict[str, str], folder: Path = Path()) -> Result:
    return Result(folder / "r.mcap", (Subject("hand", "cam", (), (), ()),), run, {}, False)


def stating(hand: dict[str, Any], **more: str) -> dict[str, str]:
    return {"configuration": json.dumps({"hand": hand, "unknown": {"key": 1}}), **more}


def test_the_hand_of_a_run_record() -> None:
    hand = {"side": "left", "scale": 0.9, "finger_lengths": [1.0, 1.1, 1.0, 1.0, 1.0]}
    anatomy = hand_of(result_of(stating(hand))).anatomy
    expected = make_anatomy("left", 0.9, (1.0, 1.1, 1.0, 1.0, 1.0))
    assert anatomy.side == "left"
    np.testing.assert_allclose(anatomy.segments, expected.segments)


@pytest.mark.parametrize(
    "text", [None, "", "[]", "{}", '{"hand": {"side": "middle"}}', '{"hand": 3}', "[" * 9999]
)
def test_a_record_without_a_hand_is_one_line(text: str | None) -> None:
    with pytest.raises(ResultError, match="run record has no hand configuration"):
        hand_of(result_of({} if text is None else {"configuration": text}))


@pytest.fixture
def mesh(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A file that is named as a hand, and stands for one; two folders below the working one."""
    from posetrack_cli.evaluation.reading import recording_of

    monkeypatch.setattr(recording_of, "hand_model", lambda settings: settings.mesh)
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "models" / "hands" / "right.glb"
    path.parent.mkdir(parents=True)
    path.write_bytes(b"a hand")
    return path


@pytest.mark.parametrize("stated", ["models/hands/right.glb", "/home/other/models/hands/right.glb"])
def test_a_hand_s_file_is_found_below_the_working_folder_or_beside_the_result(
    mesh: Path, stated: str
) -> None:
    run = stating({"mesh": stated}, **{MESH_DIGEST: file_digest(mesh)[1]})
    elsewhere = mesh.parents[2] / "results" / "today"
    elsewhere.mkdir(parents=True)
    assert Path(str(hand_of(result_of(run, elsewhere)))).samefile(mesh)
    assert Path(str(hand_of(result_of(run, mesh.parent)))).samefile(mesh)


def test_a_file_that_has_changed_is_not_the_hand_that_was_tracked(mesh: Path) -> None:
    run = stating({"mesh": "models/hands/right.glb"}, **{MESH_DIGEST: file_digest(mesh)[1]})
    mesh.write_bytes(b"another hand")
    with pytest.raises(ResultError, match=r"right\.glb: hand file has changed since the run"):
        hand_of(result_of(run))


@pytest.mark.parametrize("stated", ["{}", "../../{}", "models/../../../{}"])
def test_what_a_result_states_leads_nowhere_else(
    mesh: Path, monkeypatch: pytest.MonkeyPatch, stated: str
) -> None:
    """Not by an absolute path, nor up: a result of a stranger is no way to open any file."""
    run = stating({"mesh": stated.format(mesh)}, **{MESH_DIGEST: file_digest(mesh)[1]})
    apart = mesh.parents[2] / "apart"
    apart.mkdir()
    monkeypatch.chdir(apart)
    with pytest.raises(ResultError, match="hand file of the run not found"):
        hand_of(result_of(run, apart / "results"))


@pytest.mark.parametrize("side", ["right", "left", "auto"])
def test_bones_alone_are_those_of_the_hand(side: str) -> None:
    hand = {"side": side, "scale": 0.9, "finger_lengths": [1.0, 1.1, 1.0, 1.0, 1.0], "palm_width": 1.05}
    result = result_of(stating(hand))
    pose = np.concatenate([[0.0, 0.0, 600.0, 0.0, 0.0, 0.0, 1.0], np.linspace(0.1, 0.6, 15)])[None]
    np.testing.assert_allclose(
        joint_positions(anatomy_of(result), pose), joint_positions(hand_of(result).anatomy, pose), atol=1e-9
    )


def test_bones_of_a_file_are_those_of_the_hand(tmp_path: Path) -> None:
    path = write_hand(tmp_path / "hand.glb", make_anatomy("right", 1.1), np.eye(22)[6])
    run = stating({"mesh": "hand.glb", "side": "left"}, **{MESH_DIGEST: file_digest(path)[1]})
    result = result_of(run, tmp_path)
    pose = np.concatenate([[0.0, 0.0, 600.0, 0.0, 0.0, 0.0, 1.0], np.linspace(0.1, 0.6, 15)])[None]
    expected = joint_positions(hand_of(result).anatomy, pose)
    np.testing.assert_allclose(joint_positions(anatomy_of(result), pose), expected, atol=1e-9)
    path.write_bytes(b"another hand")
    with pytest.raises(ResultError, match="hand file has changed since the run"):
        anatomy_of(result)
