"""Exports of the dense face: ARKit's coefficients and blinks."""

from __future__ import annotations

import csv
import io

import numpy as np
import pytest

from posetrack_cli.errors import UsageError
from posetrack_cli.head.arkit import FULL_LOOK_RAD, arkit_text
from posetrack_cli.head.blinks import blinks_text
from posetrack_cli.head.dense.numbers import CLOSED
from posetrack_cli.head.subject import head_subject, with_dense_face
from posetrack_cli.results import Result, ResultWriter, Status, read_result
from posetrack_cli.results.export.source import export_source
from support.results import CAMERA, RUN, make_estimate, with_fields

SUBJECT = with_dense_face(head_subject("camera", 0))
FRAMES, LOST = 12, 3


def _numbers(index: int) -> np.ndarray:
    numbers = dict.fromkeys(SUBJECT.number_names, np.nan)
    numbers |= {
        "action_jaw_open": 0.1 * index,
        "action_left_lid_open": 0.25,
        "action_right_lid_open": 1.0,
        "left_gaze_to_left_rad": 0.5 * FULL_LOOK_RAD["side"],
        "left_gaze_up_rad": -0.2 * FULL_LOOK_RAD["up"],
        CLOSED: float(index in (1, 2, 3, 6, 9, 10, 11)),
    }
    return np.array(list(numbers.values()))


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Result:
    path = tmp_path_factory.mktemp("result") / "r.mcap"
    with ResultWriter(path, SUBJECT, CAMERA, RUN) as writer:
        for index in range(FRAMES):
            estimate = make_estimate(index, k=0, p=len(SUBJECT.point_names))
            status = Status.LOST if index == LOST else Status.TRACKING
            writer.write(with_fields(estimate, status=status, numbers=_numbers(index)))
        writer.finish({})
    return read_result(path)


def _rows(text) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO("".join(text))))


def test_coefficients(result: Result) -> None:
    rows = _rows(arkit_text(export_source(result)))

    assert len(rows) == FRAMES
    first = {name: float(value) for name, value in rows[4].items() if value}
    assert first["jawOpen"] == pytest.approx(0.4)
    assert first["eyeBlinkLeft"] == pytest.approx(0.75)
    assert first["eyeBlinkRight"] == 0.0
    assert first["eyeLookOutLeft"] == pytest.approx(0.5)
    assert first["eyeLookInLeft"] == 0.0
    assert first["eyeLookDownLeft"] == pytest.approx(0.2)
    assert rows[4]["eyeLookOutRight"] == ""
    assert rows[11]["jawOpen"] == "1.0"


def test_lost_frames_are_empty(result: Result) -> None:
    lost = _rows(arkit_text(export_source(result)))[LOST]

    assert lost["success"] == "0"
    assert lost["jawOpen"] == ""


def test_blinks_are_intervals(result: Result) -> None:
    rows = _rows(blinks_text(export_source(result)))
    stamps = result.columns()["stamp_ns"]
    seconds = (stamps - stamps[0]) / 1e9

    found = [(float(row["begin_s"]), float(row["end_s"])) for row in rows]
    # the lost frame 3 is in no blink
    assert found == [(seconds[1], seconds[2]), (seconds[6], seconds[6]), (seconds[9], seconds[11])]


def test_result_without_the_dense_face(tmp_path) -> None:
    path = tmp_path / "r.mcap"
    subject = head_subject("camera", 0)
    with ResultWriter(path, subject, CAMERA, RUN) as writer:
        writer.write(make_estimate(0, k=0, p=len(subject.point_names)))
        writer.finish({})

    for text in (arkit_text, blinks_text):
        with pytest.raises(UsageError, match="dense face"):
            list(text(export_source(read_result(path))))
