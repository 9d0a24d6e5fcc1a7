from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from posetrack_cli.head.face.templates import TemplateSet, angle_deg, is_new_direction, nearest_templates

ROOM = np.zeros((1, 1, 1, 1))


def facing(yaw_deg: float) -> np.ndarray:
    return np.array([np.sin(np.radians(yaw_deg)), 0.0, -np.cos(np.radians(yaw_deg))])


def kept(*yaws_deg: float) -> tuple[TemplateSet, ...]:
    empty = TemplateSet(ROOM, ROOM, ROOM, np.ones((1, 1), dtype=bool), facing(0.0))
    return tuple(replace(empty, facing=facing(yaw)) for yaw in yaws_deg)


def test_the_reference_is_always_compared_with_and_the_nearest_keyframe_beside_it() -> None:
    sets = kept(0.0, 15.0, 30.0)
    assert nearest_templates(sets, facing(5.0)) == (sets[0],)
    assert nearest_templates(sets, facing(20.0)) == (sets[0], sets[1])
    assert nearest_templates(sets, facing(40.0)) == (sets[0], sets[2])


@pytest.mark.parametrize(("yaw_deg", "new"), [(0.0, False), (9.0, False), (11.0, True), (26.0, False)])
def test_a_direction_is_new_where_none_near_it_is_kept(yaw_deg: float, new: bool) -> None:
    assert is_new_direction(kept(0.0, 25.0), facing(yaw_deg), 10.0) is new


def test_angles_of_rounded_unit_vectors_are_numbers() -> None:
    longer = facing(0.0) * (1.0 + 1e-12)
    assert angle_deg(longer, longer) == 0.0
    assert angle_deg(facing(0.0), facing(30.0)) == pytest.approx(30.0)
