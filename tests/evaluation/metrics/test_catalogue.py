"""The catalogue: every address is understood, every mistake is named."""

from __future__ import annotations

import pytest

from posetrack_cli.errors import UsageError
from posetrack_cli.evaluation.measuring.catalogue import (
    CATALOGUE,
    addresses,
    is_measured,
    metric_of,
    split_address,
)
from posetrack_cli.evaluation.measuring.evaluation import STATISTIC_NAMES
from posetrack_cli.evaluation.measuring.measures import GROUP_TITLES
from posetrack_cli.evaluation.measuring.subjects import KINDS
from posetrack_cli.hand.model.anatomy import ANGLE_NAMES, FINGERS, JOINT_NAMES

HEAD_POINTS = ("left_eye_outer", "left_nostril")


def test_names_are_unique_and_say_their_unit() -> None:
    names = [metric.name for metric in CATALOGUE]
    assert len(set(names)) == len(names)
    endings = {"mm": "_mm", "deg": "_deg", "mm/s": "_mm_s", "deg/s": "_deg_s", "s": "_s", "1/s": "_per_s"}
    for metric in CATALOGUE:
        if metric.unit in endings:
            assert metric.name.endswith(endings[metric.unit])


def test_every_metric_has_a_meaning_of_one_sentence() -> None:
    for metric in CATALOGUE:
        assert metric.meaning[0].isupper()
        assert metric.meaning.endswith(".")
        assert metric.meaning.count(". ") == 0


def test_groups_follow_each_other_as_titled() -> None:
    order = [metric.group for metric in CATALOGUE]
    assert list(dict.fromkeys(order)) == list(GROUP_TITLES)
    assert order == sorted(order, key=list(GROUP_TITLES).index)


def test_no_part_is_called_like_a_statistic() -> None:
    parts = {part for kind in KINDS.values() for parts in kind.parts.values() for part in parts}
    assert {*JOINT_NAMES, *FINGERS, *ANGLE_NAMES} < parts
    assert not parts & set(STATISTIC_NAMES)


@pytest.mark.parametrize("subject", ["hand", "head"])
def test_every_address_is_understood_with_every_statistic(subject: str) -> None:
    known = addresses(subject, HEAD_POINTS if subject == "head" else ())
    assert len(set(known)) == len(known)
    for address in known:
        plain = split_address(address)
        assert plain.base == address
        assert plain.statistic is None
        assert plain.metric is metric_of(address)
        assert is_measured(plain.metric, KINDS[subject])
        for statistic in () if plain.metric.scalar else STATISTIC_NAMES:
            full = split_address(f"{address}.{statistic}")
            assert (full.base, full.statistic) == (address, statistic)


def test_a_hand_has_every_part_in_its_place() -> None:
    known = addresses("hand")
    at = known.index("joint_error_mm")
    assert known[at + 1 : at + 22] == tuple(f"joint_error_mm.{name}" for name in JOINT_NAMES)
    assert {f"finger_error_mm.{name}" for name in FINGERS} <= set(known)
    assert {f"angle_error_deg.{name}" for name in ANGLE_NAMES} <= set(known)
    assert {"inside_90.position", "inside_90.rotation", "inside_90.angles"} <= set(known)
    assert "x_mm" not in known


def test_a_head_has_its_points_and_no_angles() -> None:
    known = addresses("head", HEAD_POINTS)
    assert {f"point_error_mm.{name}" for name in HEAD_POINTS} <= set(known)
    assert {"inside_90.position", "inside_90.rotation"} <= set(known)
    assert not {"inside_90.angles", "joint_error_mm", "angle_error_deg"} & set(known)


def test_points_of_a_head_are_taken_on_trust() -> None:
    assert split_address("point_error_mm.left_nostril.mean").part == "left_nostril"


def test_other_joints_than_ours_can_be_listed() -> None:
    assert "joint_error_mm.knuckle" in addresses("hand", ("knuckle",))


@pytest.mark.parametrize(
    ("address", "message"),
    [
        (
            "joint_eror_mm.mean",
            r"unknown metric 'joint_eror_mm'; did you mean 'joint_error_mm'\? known: angle_err",
        ),
        ("qqq", r"unknown metric 'qqq'; known: angle_error_deg, .*z_mm$"),
        ("", r"unknown metric ''; known: "),
        ("joint_error_mm.maen", r"'joint_error_mm' has no 'maen'; did you mean 'mean'\? known: count, index"),
        ("joint_error_mm.index_tp.mean", r"has no 'index_tp.mean'; did you mean 'index_tip'\?"),
        ("coverage.mean", r"'coverage' has no 'mean'; it is a single number without parts or statistics"),
        ("nees.position", r"'nees' has no 'position'; known: count, max, mean"),
        ("joint_error_mm.wrist.wrist", r"'joint_error_mm' has no 'wrist.wrist'"),
        ("joint_error_mm.mean.max", r"'joint_error_mm' has no 'mean.max'"),
        ("joint_error_mm.", r"'joint_error_mm' has no ''"),
        (
            "inside_90.position.mean",
            r"'inside_90' has no 'position.mean'; .*known: .*position, .*rotation",
        ),
    ],
)
def test_a_mistake_is_named_with_what_there_is(address: str, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        split_address(address)
