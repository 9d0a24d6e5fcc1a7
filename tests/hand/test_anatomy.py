"""The hand's bones: names, tree, lengths beside published ones, rest pose, limits."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from posetrack_cli.hand.model.anatomy import (
    ANGLE_LIMITS,
    ANGLE_NAMES,
    FINGERS,
    HAND_LENGTH_MM,
    JOINT_NAMES,
    JOINT_PARENTS,
    make_anatomy,
)
from posetrack_cli.hand.model.kinematics import joint_positions
from support.hand import BONE_LENGTHS_MM, REST, bent

ROUNDING_MM = 1e-9


def rest_joints(side: str = "right", **sizes: object) -> dict[str, np.ndarray]:
    positions = joint_positions(make_anatomy(side, **sizes), REST[None])[0]
    return dict(zip(JOINT_NAMES, positions, strict=True))


def segment_lengths(joints: dict[str, np.ndarray], finger: str) -> list[float]:
    chain = [joints[name] for name in JOINT_NAMES if name.startswith(finger)]
    return [float(np.linalg.norm(b - a)) for a, b in itertools.pairwise(chain)]


def test_21_joints_in_a_tree_of_five_fingers() -> None:
    assert len(set(JOINT_NAMES)) == len(JOINT_PARENTS) == 21
    assert JOINT_PARENTS[0] == -1
    for joint, parent in enumerate(JOINT_PARENTS[1:], start=1):
        finger = JOINT_NAMES[joint].split("_")[0]
        above = JOINT_NAMES[parent]
        assert parent < joint
        assert above == "wrist" if (joint - 1) % 4 == 0 else above.startswith(finger)
    assert tuple(dict.fromkeys(name.split("_")[0] for name in JOINT_NAMES[1:])) == FINGERS


def test_15_angles_in_the_paper_s_order() -> None:
    # appendix A.1: p8 joint 3 about x; p9, p10 joint 2 about x, z; then p11.. MCP x, z, PIP x a finger
    assert ANGLE_NAMES[:3] == ("thumb_cmc_flexion", "thumb_mcp_flexion", "thumb_cmc_abduction")
    for f, finger in enumerate(FINGERS[1:], start=1):
        assert ANGLE_NAMES[3 * f : 3 * f + 3] == (
            f"{finger}_mcp_flexion",
            f"{finger}_mcp_abduction",
            f"{finger}_pip_flexion",
        )


@pytest.mark.parametrize("finger", FINGERS)
def test_bones_are_as_long_as_people_s(finger: str) -> None:
    """Buryanov and Kotiuk 2010: bones of adults vary by a tenth of their length; these are of the mean."""
    metacarpal, proximal, middle, distal, tip = BONE_LENGTHS_MM[finger]
    # the thumb has one phalanx less, and its metacarpal moves
    published = [*((metacarpal, proximal) if finger == "thumb" else (proximal, middle)), distal + tip]
    found = segment_lengths(rest_joints(), finger)
    np.testing.assert_allclose(found, published, rtol=0.2)
    if finger != "thumb":  # fingers are divided alike, whatever their length
        shares = [np.array(lengths) / sum(lengths) for lengths in (found, published)]
        np.testing.assert_allclose(*shares, atol=0.02)
    assert segment_lengths(rest_joints("left"), finger) == pytest.approx(found)


def test_the_mean_hand_is_179_mm_long() -> None:
    joints = rest_joints()
    length = np.linalg.norm(joints["middle_mcp"]) + sum(segment_lengths(joints, "middle"))
    assert length == pytest.approx(HAND_LENGTH_MM, abs=0.5)
    assert HAND_LENGTH_MM == 179.0


@pytest.mark.parametrize("finger", FINGERS[1:])
def test_knuckles_lie_a_metacarpal_and_a_carpus_from_the_wrist(finger: str) -> None:
    # the carpus is not in the table: hands have some 15-30 mm of it, and metacarpals differ by a tenth
    joints = rest_joints()
    carpus = np.linalg.norm(joints[f"{finger}_mcp"] - joints["wrist"]) - BONE_LENGTHS_MM[finger][0]
    assert 10.0 < carpus < 35.0


def test_scale_and_finger_lengths() -> None:
    usual, large = rest_joints(), rest_joints(scale=1.25, finger_lengths=(1.0, 1.0, 0.5, 1.0, 1.0))
    for name in JOINT_NAMES:
        if not name.startswith("middle") or name == "middle_mcp":
            np.testing.assert_allclose(large[name], 1.25 * usual[name], atol=ROUNDING_MM)
    expected = 1.25 * 0.5 * np.array(segment_lengths(usual, "middle"))
    np.testing.assert_allclose(segment_lengths(large, "middle"), expected, atol=ROUNDING_MM)
    assert np.array_equal(make_anatomy(scale=1.25).radii, 1.25 * make_anatomy().radii)


def test_rest_pose_has_fingers_up_and_a_right_thumb_at_plus_x() -> None:
    right, left = rest_joints("right"), rest_joints("left")
    for finger in FINGERS[1:]:
        up = right[f"{finger}_tip"] - right[f"{finger}_mcp"]
        assert -up[1] > 0.95 * np.linalg.norm(up)
        assert abs(up[2]) < ROUNDING_MM  # stretched out: in the palm's plane
    across = [right[f"{finger}_mcp"][0] for finger in FINGERS]
    assert across == sorted(across, reverse=True)  # the thumb's side is +x
    assert right["thumb_tip"][0] > right["index_mcp"][0] + 20.0
    assert right["thumb_tip"][2] < 0.0  # in front of the palm
    assert left["thumb_tip"][0] == -right["thumb_tip"][0]


@pytest.mark.parametrize(("side", "thumb"), [("right", 1.0), ("left", -1.0)])
def test_flexion_goes_to_the_palm_and_abduction_to_the_thumb(side: str, thumb: float) -> None:
    def tip(finger: str, **angles: float) -> np.ndarray:
        joints = joint_positions(make_anatomy(side), bent(**angles)[None])[0]
        return joints[JOINT_NAMES.index(f"{finger}_tip")]

    for name in ANGLE_NAMES:
        finger = name.split("_")[0]
        motion = tip(finger, **{name: 0.2}) - tip(finger)
        if "abduction" in name and finger != "thumb":
            assert thumb * motion[0] > 5.0
        elif finger != "thumb":
            assert motion[2] < -5.0  # the palm faces the sensor, -z
        elif "flexion" in name:
            assert thumb * motion[0] < -3.0  # across the palm
            assert motion[2] < -3.0


def test_joint_limits_are_those_of_the_method() -> None:
    limits = dict(zip(ANGLE_NAMES, np.rad2deg(ANGLE_LIMITS).round(9).tolist(), strict=True))
    assert limits["thumb_cmc_flexion"] == [-45.0, 74.0]
    assert limits["thumb_cmc_abduction"] == [-35.0, 35.0]
    assert limits["thumb_mcp_flexion"] == [0.0, 74.0]
    abductions = {"index": [-19, 28], "middle": [-28, 17], "ring": [-17, 17], "little": [-39, 28]}
    for finger, abduction in abductions.items():
        assert limits[f"{finger}_mcp_flexion"] == [-15.0, 90.0]
        assert limits[f"{finger}_mcp_abduction"] == abduction
        assert limits[f"{finger}_pip_flexion"] == [0.0, 108.0]
    assert (ANGLE_LIMITS[:, 0] <= 0).all()  # the rest pose is allowed
    assert (ANGLE_LIMITS[:, 1] > 0).all()
