"""Shapes of hands: sixteen factors, what they do to bones and skin, and where they come from."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from posetrack_cli.configuration import validated
from posetrack_cli.errors import UsageError
from posetrack_cli.hand.anatomy import FINGERS, MIRROR, SEGMENT_RADII, make_anatomy
from posetrack_cli.hand.config import HandSettings
from posetrack_cli.hand.kinematics import joint_positions
from posetrack_cli.hand.mesh import hand_mesh
from posetrack_cli.hand.model import average_hand, hand_model
from posetrack_cli.hand.shape import POPULATION_SD, SHAPE_NAMES, SHAPE_SIZE, HandShape, random_shape
from posetrack_cli.rendering.mesh import is_closed
from support.hand import REST, enclosed_volume

AVERAGE = make_anatomy()


def shapes() -> st.SearchStrategy[HandShape]:
    """Every shape that a configuration may state, corners included, of scale near 1."""
    low = np.array([0.5, *[0.7] * (SHAPE_SIZE - 2), 0.5])
    high = np.array([1.6, *[1.4] * (SHAPE_SIZE - 2), 2.5])
    shares = st.lists(st.floats(0.0, 1.0), min_size=SHAPE_SIZE, max_size=SHAPE_SIZE)
    return shares.map(lambda share: HandShape.of_factors(low + (high - low) * np.array(share)))


@settings(deadline=None, max_examples=40)
@given(shapes())
def test_the_skin_of_any_shape_is_closed_and_faces_outwards(shape: HandShape) -> None:
    hand = average_hand("right", shape)
    for mesh in (hand.lean, hand.smooth, hand_mesh(hand.anatomy, "lean")):
        assert is_closed(mesh.triangles)
        assert np.isfinite(mesh.vertices).all()
        assert enclosed_volume(mesh.vertices, mesh.triangles) > 0.0
    # rings of a finger follow each other towards the tip: nothing folds back
    cage = hand_mesh(hand.anatomy, "lean")
    for finger in range(5):
        along = (
            -(cage.vertices - hand.anatomy.base_positions[finger]) @ hand.anatomy.base_rotations[finger][:, 1]
        )
        heights = [
            along[(cage.weights[:, bone] >= share - 1e-9) & (cage.weights[:, bone] <= share + 1e-9)].mean()
            for bone, share in ((1 + 3 * finger, 0.75), (2 + 3 * finger, 0.75), (2 + 3 * finger, 0.5))
        ]
        tip = along[cage.weights[:, 3 + 3 * finger] > 0.99].max()
        assert np.all(np.diff([*heights, tip]) > 0.0)


@settings(deadline=None, max_examples=25)
@given(shapes())
def test_a_left_hand_is_the_mirror_image(shape: HandShape) -> None:
    right, left = average_hand("right", shape), average_hand("left", shape)
    np.testing.assert_allclose(left.smooth.vertices, right.smooth.vertices * MIRROR, atol=1e-9)
    np.testing.assert_allclose(left.lean.vertices, right.lean.vertices * MIRROR, atol=1e-9)
    joints = [joint_positions(hand.anatomy, REST[None])[0] for hand in (right, left)]
    np.testing.assert_allclose(joints[1], joints[0] * MIRROR, atol=1e-9)


@settings(deadline=None, max_examples=25)
@given(shapes())
def test_joints_and_radii_follow_the_factors(shape: HandShape) -> None:
    anatomy = average_hand("right", shape).anatomy
    joints = joint_positions(anatomy, REST[None])[0]
    np.testing.assert_allclose(joints[[0]], 0.0, atol=1e-12)
    for finger in range(5):
        chain = joints[1 + 4 * finger : 5 + 4 * finger]
        wanted = shape.scale * shape.finger_lengths[finger] * AVERAGE.segments[finger]
        np.testing.assert_allclose(np.linalg.norm(np.diff(chain, axis=0), axis=1), wanted, atol=1e-9)
        radii = shape.scale * shape.finger_widths[finger] * SEGMENT_RADII[finger]
        np.testing.assert_allclose(anatomy.radii[finger], radii, atol=1e-9)
        place = [1.0, shape.thumb_place if finger == 0 else 1.0, 1.0]
        base = shape.scale * AVERAGE.base_positions[finger] * shape.palm * place
        np.testing.assert_allclose(chain[0], base, atol=1e-9)


def extent(shape: HandShape, marked: np.ndarray, axis: int) -> float:
    """Length along an axis of the marked vertices of the medium mesh, mm."""
    return float(np.ptp(average_hand("right", shape).smooth.vertices[marked, axis]))


def test_each_factor_changes_what_it_is_called_after() -> None:
    mesh = hand_mesh(AVERAGE, "medium")
    palm = mesh.weights[:, 0] > 0.99
    wrist = palm & (mesh.vertices[:, 1] > -5.0)
    usual = HandShape()
    assert extent(HandShape(palm_width=1.2), wrist, 0) == pytest.approx(
        1.2 * extent(usual, wrist, 0), rel=0.02
    )
    assert extent(HandShape(wrist_width=1.2), wrist, 0) == pytest.approx(
        1.2 * extent(usual, wrist, 0), rel=0.05
    )
    assert extent(HandShape(palm_thickness=1.2), palm, 2) == pytest.approx(
        1.2 * extent(usual, palm, 2), rel=0.02
    )
    middle = mesh.weights[:, 8] > 0.6  # its second bone
    widths = (1.0, 1.0, 1.2, 1.0, 1.0)
    assert extent(HandShape(finger_widths=widths), middle, 0) == pytest.approx(
        1.2 * extent(usual, middle, 0), rel=0.03
    )


def test_a_wider_finger_leaves_the_others_as_they_are() -> None:
    widths = (1.0, 1.0, 1.0, 1.0, 1.3)
    usual, wide = (hand_mesh(make_anatomy(finger_widths=w)) for w in ((1.0,) * 5, widths))
    thumb = usual.weights[:, 1:4].sum(axis=1) > 0.99
    np.testing.assert_array_equal(wide.vertices[thumb], usual.vertices[thumb])


def test_factors_and_shape_are_each_other() -> None:
    factors = np.linspace(0.8, 1.2, SHAPE_SIZE)
    shape = HandShape.of_factors(factors)
    np.testing.assert_array_equal(shape.factors, factors)
    by_name = dict(zip(SHAPE_NAMES, factors, strict=True))
    assert shape.scale == by_name["scale"] and shape.thumb_place == by_name["thumb_place"]
    assert shape.finger_lengths == tuple(by_name[f"{finger}_length"] for finger in FINGERS)
    assert shape.finger_widths == tuple(by_name[f"{finger}_width"] for finger in FINGERS)
    assert shape.palm == (by_name["palm_width"], by_name["palm_length"], by_name["palm_thickness"])
    assert shape.wrist_width == by_name["wrist_width"]
    assert len(POPULATION_SD) == SHAPE_SIZE


def test_random_hands_differ_as_much_as_promised() -> None:
    factors = np.array([random_shape(np.random.default_rng(seed)).factors for seed in range(400)])
    spread = np.array([0.15, *[0.10] * (SHAPE_SIZE - 1)])
    assert (np.abs(factors - 1.0) <= spread).all()
    # uniform: that none of 400 lies in the outermost 5 per cent of the range has a chance of .95^400, 1e-9
    assert (factors.max(axis=0) > 1.0 + 0.9 * spread).all() and (
        factors.min(axis=0) < 1.0 - 0.9 * spread
    ).all()
    same = [random_shape(np.random.default_rng(5)) for _ in range(2)]
    assert same[0] == same[1]


def test_the_configuration_s_hand() -> None:
    settings = HandSettings(side="left", scale=0.9, finger_widths=(1.0, 1.1, 1.0, 1.0, 1.0), palm_length=1.1)
    made = hand_model(settings)
    expected = average_hand("left", HandShape(0.9, finger_widths=(1.0, 1.1, 1.0, 1.0, 1.0), palm_length=1.1))
    np.testing.assert_array_equal(made.smooth.vertices, expected.smooth.vertices)
    assert len(made.skin("fine").triangles) == 4 * len(made.skin("medium").triangles)
    assert made.skin("lean") is made.lean


@pytest.mark.parametrize(
    "values", [{"palm_width": 0.5}, {"finger_widths": [1.0] * 4}, {"wrist_width": 2.0}, {"thumb_place": 3.0}]
)
def test_shapes_that_fold_are_refused(values: dict[str, object]) -> None:
    with pytest.raises(UsageError, match=next(iter(values))):
        validated(HandSettings, values, "hand.toml")
