"""Metrics of the dense face against landmarks."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from posetrack_cli.evaluation.measuring.face_metrics import (
    GAZE_NAMES,
    NAMES,
    NUMBERS_USED,
    SIDES,
    blink_f1,
    eye_metrics,
    face_metrics,
)
from posetrack_cli.evaluation.measuring.measures import Matched, Measures
from posetrack_cli.evaluation.reading.tracks import Pairs, Track
from posetrack_cli.head.dense.numbers import CLOSED

FRAMES = 40
GAP = 3.0 + 2.0 * np.sin(np.arange(FRAMES) / 3.0)
OPENING = np.where(np.isin(np.arange(FRAMES), [10, 11, 25, 26, 27]), 1.0, 9.0)
BROW = 20.0 + np.cos(np.arange(FRAMES) / 5.0)


@pytest.fixture
def landmarks(tmp_path: Path) -> Path:
    places = np.zeros((FRAMES, 68, 3))
    places[:, 66, 1] = -GAP
    for upper, lower in ((37, 41), (38, 40), (43, 47), (44, 46)):
        places[:, upper, 1], places[:, lower, 1] = 0.5 * OPENING, -0.5 * OPENING
    places[:, 17:27, 1] = BROW[:, None]
    names = [f"p{k}_{axis}_mm" for k in NUMBERS_USED for axis in "xyz"]
    rows = places[:, NUMBERS_USED].reshape(FRAMES, -1)
    path = tmp_path / "landmarks.csv"
    lines = [",".join(["t_s", *names])]
    lines += [",".join(map(str, [index / 30, *row])) for index, row in enumerate(rows)]
    path.write_text("\n".join(lines))
    return path


def _track(**changed):
    named = {
        "action_lip_gap_mm": GAP + 0.5,
        "action_right_lid_mm": OPENING + 1.0,
        "action_left_lid_mm": OPENING - 1.0,
        CLOSED: (OPENING < 5.0).astype(float),
    }
    named |= {
        f"action_{side}_brow_{part}_mm": BROW - 20.0
        for side in ("right", "left")
        for part in ("inner", "outer")
    }
    named |= changed
    stamps = np.round(np.arange(FRAMES) / 30 * 1e9).astype(np.int64)
    numbers = np.stack(list(named.values()), axis=1)
    return SimpleNamespace(stamp_ns=stamps, number_names=tuple(named), numbers=numbers, lost=None)


def _metrics(track, path: Path) -> Measures:
    measures = Measures("nothing")
    face_metrics(measures, track, path, 5_000_000)
    return measures


def test_constant_errors(landmarks: Path) -> None:
    found = _metrics(_track(), landmarks).metrics

    assert found["lip_gap_error_mm"].mean == pytest.approx(0.5)
    # a constant difference of lids and brows is a matter of definition
    assert found["lid_opening_error_mm"].mean == pytest.approx(0.0, abs=1e-9)
    assert found["brow_height_error_mm"].mean == pytest.approx(0.0, abs=1e-9)
    assert [found[name] for name in ("lip_gap_r", "lid_opening_r", "brow_height_r")] == pytest.approx(
        [1.0] * 3
    )
    assert found["blink_f1"] == 1.0


def test_a_missed_blink(landmarks: Path) -> None:
    closed = (OPENING < 5.0).astype(float)
    closed[20:] = 0.0

    found = _metrics(_track(**{CLOSED: closed}), landmarks).metrics

    assert found["blink_f1"] == pytest.approx(2.0 / 3.0)


def test_result_without_the_dense_face(landmarks: Path) -> None:
    track = SimpleNamespace(
        stamp_ns=np.arange(3), number_names=("score",), numbers=np.zeros((3, 1)), lost=None
    )

    assert set(_metrics(track, landmarks).absent) == set(NAMES)


def _gazes(angle: float) -> dict[str, np.ndarray]:
    """Numbers of eyes that look ahead, of a head that faces the camera, but for an angle to the left."""
    named = {f"action_{side}_lid_mm": OPENING for side in SIDES} | {CLOSED: (OPENING < 5.0).astype(float)}
    gaze = {"x": np.sin(angle), "y": 0.0, "z": -np.cos(angle), "sd_rad": np.radians(2.0)}
    return named | {f"{side}_gaze_{k}": np.full(FRAMES, value) for side in SIDES for k, value in gaze.items()}


def _matched(mine: dict[str, np.ndarray], theirs: dict[str, np.ndarray]) -> Matched:
    rows = np.arange(FRAMES)

    def track(named: dict[str, np.ndarray]) -> Track:
        facing = np.tile([1.0, 0.0, 0.0, 0.0], (FRAMES, 1))
        numbers = np.stack(list(named.values()), axis=1)
        kept = {"quaternion": facing, "numbers": numbers, "number_names": tuple(named)}
        return Track("a", "head", (), (), (), stamp_ns=rows * 33_000_000, **kept)

    return Matched(track(mine), track(theirs), Pairs(rows, rows))


def test_gaze_against_the_truth() -> None:
    off, true = _gazes(np.radians(3.0)), _gazes(0.0)
    off["left_gaze_x"] = np.full(FRAMES, np.nan)
    off["right_gaze_x"] = np.where(OPENING < 5.0, np.nan, off["right_gaze_x"])
    off["left_gaze_x"][0] = true["left_gaze_x"][0]
    off["left_gaze_z"][0] = true["left_gaze_z"][0]
    measures = Measures("nothing")
    eye_metrics(measures, _matched(off, true))

    found = measures.metrics
    assert found["right_gaze_deg"].mean == pytest.approx(3.0)
    assert found["left_gaze_deg"].mean == pytest.approx(0.0, abs=1e-6)
    # 3 deg are inside 1.645 times 2 deg
    assert found["gaze_inside_90"] == 1.0
    assert found["blink_f1"] == 1.0


def test_no_gaze_is_known() -> None:
    unknown = _gazes(0.0) | {"right_gaze_x": np.full(FRAMES, np.nan)}
    measures = Measures("nothing")
    eye_metrics(measures, _matched(unknown, _gazes(0.0)))

    assert set(GAZE_NAMES) <= set(measures.absent)


@pytest.mark.parametrize(
    ("found", "true", "expected"),
    [
        ([(1.0, 1.2)], [(1.25, 1.4)], 1.0),
        ([(1.0, 1.1)], [(1.25, 1.4)], 0.0),
        ([(1.0, 1.2), (3.0, 3.1)], [(1.0, 1.2)], 2.0 / 3.0),
    ],
)
def test_f1_of_intervals(found, true, expected) -> None:
    assert blink_f1(np.array(found), np.array(true)) == pytest.approx(expected)
