"""Model files whose arrays are incomplete, of another shape or damaged are told, whichever array it is."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from posetrack_cli.errors import ResultError
from posetrack_cli.head.config import HeadStereoConfig, ModelSettings
from posetrack_cli.head.face.points import MEAN_SHAPE, POINT_COUNT
from posetrack_cli.head.face.templates import WINDOW, TemplateSet
from posetrack_cli.head.initialisation.search import NO_FACE, InitFailure
from posetrack_cli.head.model_file import model_bytes
from posetrack_cli.head.run import HeadRun, HeadRunOptions
from posetrack_cli.head.subject import head_subject
from posetrack_cli.head.tracker.face_learning import new_face
from posetrack_cli.head.tracker.head_tracker import HeadTracker
from posetrack_cli.head.tracker.stereo import StereoCodecs, StereoFace, StereoState
from posetrack_cli.recording.base import Frame
from support.head_run import CAMERAS, Memory

NEEDED = (
    *(f"face.{name}" for name in ("mean", "components", "variance", "counts")),
    *(f"sets.{name}" for name in ("windows", "centres", "tangents", "seen", "facing")),
)
CODECS = StereoCodecs(2, ModelSettings())


class Nobody:
    """Finds no face."""

    def find(self, frame: Frame, *, is_first: bool, is_known: bool) -> InitFailure:
        return InitFailure(NO_FACE)


def learned(cameras: int = 2) -> dict[str, np.ndarray[Any, Any]]:
    """What a tracker has learned that found a face and no more."""
    seen = (cameras, POINT_COUNT)
    templates = TemplateSet(
        np.zeros((*seen, WINDOW, WINDOW), np.uint8),
        np.full((*seen, 2), np.nan),  # as of points that no camera sees
        np.zeros((*seen, 2, 2)),
        np.zeros(seen, bool),
        np.array([0.0, 0.0, -1.0]),
    )
    return CODECS.to_model(
        StereoState(face=new_face(MEAN_SHAPE, ModelSettings()), templates=(templates, templates))
    )


def test_what_a_tracker_has_learned_is_taken_but_for_its_search() -> None:
    state = CODECS.from_model(learned())
    assert state.face is not None
    np.testing.assert_array_equal(state.face.model.mean, MEAN_SHAPE)
    assert (len(state.templates), state.track, state.search.frames) == (2, None, 0)


def test_the_shape_found_is_kept_where_frames_are_tracked_with_it() -> None:
    printed = ModelSettings(rigid_phase="printed")
    codecs, before = StereoCodecs(2, printed), CODECS.from_model(learned())
    assert "face.found" not in learned()
    state = StereoState(face=new_face(MEAN_SHAPE + 1.0, printed), templates=before.templates)
    kept = codecs.to_model(state)
    found = codecs.from_model(kept).known_face.found
    assert found is not None
    np.testing.assert_array_equal(found.mean, MEAN_SHAPE + 1.0)
    assert CODECS.from_model(kept).known_face.found is None  # of no use to other settings
    without = codecs.from_model(learned()).known_face.found  # nor kept by them: the mean is taken for it
    assert without is not None
    np.testing.assert_array_equal(without.mean, MEAN_SHAPE)


@pytest.mark.parametrize("name", NEEDED)
def test_every_array_is_needed_and_has_its_shape_and_kind(name: str) -> None:
    arrays = learned()
    del arrays[name]
    with pytest.raises(ResultError, match=f"incomplete or damaged, found array '{name}' is missing"):
        CODECS.from_model(arrays)
    for wrong in (np.array(["text"]), learned()[name][None], np.zeros(0, learned()[name].dtype)):
        with pytest.raises(ResultError, match=f"found '{name}' is "):
            CODECS.from_model(learned() | {name: wrong})


def test_templates_of_other_cameras_and_of_different_lengths() -> None:
    with pytest.raises(ResultError, match=r"found 'sets.windows' is uint8 \(2, 3, 10, 48, 48\)"):
        CODECS.from_model(learned(cameras=3))
    with pytest.raises(ResultError, match=r"'sets.facing' is float64 \(1, 3\), expected float64 \(2, 3\)"):
        CODECS.from_model(learned() | {"sets.facing": np.zeros((1, 3))})


def test_a_face_that_is_not_finite() -> None:
    with pytest.raises(ResultError, match=r"'face.mean' has values that are not finite"):
        CODECS.from_model(learned() | {"face.mean": np.full((POINT_COUNT, 3), np.inf)})


@pytest.mark.parametrize("left_out", [(), ("sets.facing",), NEEDED], ids=["none", "one", "all"])
def test_a_run_tells_the_file(tmp_path: Path, left_out: tuple[str, ...]) -> None:
    path, config = tmp_path / "face.npz", HeadStereoConfig()
    arrays = {name: values for name, values in learned().items() if name not in left_out}
    path.write_bytes(model_bytes(arrays, CAMERAS, "head-stereo"))

    def run() -> HeadRun:
        return HeadRun(
            Memory(),
            config,
            HeadRunOptions(tmp_path / "r.mcap", load_model=path),
            name="head-stereo",
            subject=head_subject("left", 5),
            flush_frames=30,
            make_tracker=lambda known: HeadTracker(StereoFace(config, CAMERAS, Nobody(), known)),
        )

    if not left_out:
        assert run().tracker.learned(run().tracker.start(Frame(0, 0, (None, None)), None)).keys() >= set(
            NEEDED
        )
        return
    with pytest.raises(ResultError) as told:
        run()
    assert str(told.value).startswith(f"{path}: model is incomplete or damaged, found array '")
