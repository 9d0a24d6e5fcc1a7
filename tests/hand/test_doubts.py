"""What is doubtful about a hand's shape: said in a line, with what to do; the first doubt alone."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import pytest

from posetrack_cli.hand.model.anatomy import HAND_LENGTH_MM, HandShape
from posetrack_cli.hand.shape_fit import (
    HAND_LENGTHS_MM,
    LARGEST_COEFFICIENT,
    UNOBSERVED_SHARE,
    Calibration,
)
from support.calibrations import calibration_of

USUAL = calibration_of(HandShape(coefficients=(1.0, -1.0)))


def hardly_seen(found: Calibration, names: Iterable[str], share: float = 1.0) -> Calibration:
    """The same with measures as uncertain as they were before the recording, or nearly."""
    numbers = found.measured
    sd = dict(numbers.sd) | {name: share * numbers.prior_sd[name] for name in names}
    return replace(found, measured=replace(numbers, sd=sd))


def test_a_hand_like_others_that_was_seen_well_has_none() -> None:
    assert USUAL.warning == ""


@pytest.mark.parametrize("length_mm", [HAND_LENGTHS_MM[0] - 5.0, HAND_LENGTHS_MM[1] + 5.0])
def test_no_hand_is_so_large_or_so_small(length_mm: float) -> None:
    """Most likely the depth is in other units."""
    found = calibration_of(HandShape(length_mm / HAND_LENGTH_MM, coefficients=(LARGEST_COEFFICIENT + 1.0,)))
    said = found.warning
    assert found.length_mm == pytest.approx(length_mm, abs=1.5)
    assert "120 to 225 mm" in said and "--depth-unit-mm" in said and "would give" in said
    assert "proportions" not in said


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_hardly_any_hand_has_such_proportions(sign: float) -> None:
    said = [
        calibration_of(HandShape(coefficients=(0.0, sign * (LARGEST_COEFFICIENT + off)))).warning
        for off in (-0.1, 0.1)
    ]
    assert said[0] == "" and "unusual proportions" in said[1]


@pytest.mark.parametrize(
    ("names", "part"),
    [
        (["index_length", "middle_length", "ring_length", "little_length"], "finger lengths"),
        (["thumb_length"], "thumb"),
        (["palm_length", "palm_width"], "palm"),
    ],
)
def test_what_the_recording_hardly_showed_is_asked_for(names: list[str], part: str) -> None:
    said = hardly_seen(USUAL, names).warning
    assert f"its {part} hardly visible; record " in said and "facing the sensor" in said
    assert hardly_seen(USUAL, names, UNOBSERVED_SHARE - 0.01).warning == ""
    if len(names) > 1:  # one finger that is hidden is no doubt of all
        assert hardly_seen(USUAL, names[1:]).warning == ""
