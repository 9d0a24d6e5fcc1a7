"""Shapes of hands: coefficients and sixteen factors, what they do to bones and skin, where they come from."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from posetrack_cli.configuration import validated
from posetrack_cli.errors import UsageError
from posetrack_cli.hand.config import HandSettings
from posetrack_cli.hand.model.anatomy import (
    COEFFICIENTS,
    FINGERS,
    MAX_DRAWN,
    MIRROR,
    MOST_COEFFICIENT,
    POPULATION_SD,
    SHAPE_NAMES,
    SHAPE_SIZE,
    FactorSpace,
    HandShape,
    PopulationSpace,
    ShapeSpace,
    make_anatomy,
    random_shape,
    reshaped_anatomy,
    shape_between,
    shape_space,
)
from posetrack_cli.hand.model.hand import average_hand, hand_mesh, hand_model
from posetrack_cli.hand.model.kinematics import joint_positions
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
        radii = shape.scale * shape.finger_widths[finger] * AVERAGE.radii[finger]
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


def test_random_hands_differ_as_people_do() -> None:
    shapes = [random_shape(np.random.default_rng(seed)) for seed in range(400)]
    assert all(shape.factors[1:] == pytest.approx(1.0) for shape in shapes)
    scales = np.array([shape.scale for shape in shapes])
    # uniform: that none of 400 lies in the outermost 5 per cent of the range has a chance of .95^400, 1e-9
    assert 0.85 <= scales.min() < 0.865 and 1.135 < scales.max() <= 1.15
    drawn = np.array([shape.coefficients for shape in shapes])
    assert drawn.shape[1] == COEFFICIENTS and np.abs(drawn).max() == MAX_DRAWN
    # normal, cut at 2: of variance 1 - 2 * (what lies beyond) about .92; sd of it sqrt(2 / 400) each
    assert (np.abs(drawn.mean(axis=0)) < 5.0 / np.sqrt(400)).all()
    assert (np.abs(drawn.var(axis=0) - 0.92) < 5.0 * np.sqrt(2.0 / 400)).all()
    assert random_shape(np.random.default_rng(5)) == shapes[5]


@pytest.mark.parametrize("space", [PopulationSpace(), FactorSpace()], ids=["population", "factors"])
def test_a_shape_s_numbers_are_the_shape_s(space: ShapeSpace) -> None:
    size = len(space.names)
    assert {len(values) for values in (space.sd, space.low, space.high, space.steps)} == {size}
    np.testing.assert_allclose(space.theta(HandShape()), 0.0)
    assert space.shape(np.zeros(size)).factors == pytest.approx(1.0)
    rng = np.random.default_rng(3)
    for theta in (space.low, space.high, *(space.sd * rng.standard_normal((5, size))).clip(space.low)):
        np.testing.assert_allclose(space.theta(space.shape(theta)), theta, atol=1e-12)
    is_signed = np.array(space.names) != "padding_mm"  # skin stands out, or does not
    assert (space.low < -2.0 * space.sd)[is_signed].all() and (space.low[~is_signed] == 0.0).all()
    assert (space.high > 2.0 * space.sd).all()


@pytest.mark.parametrize("space", [PopulationSpace(), FactorSpace()], ids=["population", "factors"])
def test_a_configuration_takes_every_shape_of_a_space(space: ShapeSpace) -> None:
    """So what a calibration finds can be written, and read again."""
    for theta in (space.low, space.high):
        shape = space.shape(theta)
        stated = {name: getattr(shape, name) for name in HandSettings.model_fields if hasattr(shape, name)}
        assert HandSettings.model_validate(stated).shape == shape


def test_what_is_unknown_of_a_hand() -> None:
    names = shape_space(None).names
    assert (names[0], names[-1]) == ("scale", "padding_mm") and len(names) == 1 + COEFFICIENTS + 1
    assert shape_space("hand.glb").names == SHAPE_NAMES
    short = HandShape(1.1, coefficients=(0.5, -1.0))
    padded = shape_space(None).shape(shape_space(None).theta(short))
    assert padded.coefficients == (0.5, -1.0, *[0.0] * (COEFFICIENTS - 2))


@pytest.mark.parametrize("side", ["right", "left"])
@settings(deadline=None, max_examples=25)
@given(shape=shapes())
def test_the_shape_between_two_hands_takes_one_to_the_other(side: str, shape: HandShape) -> None:
    other = reshaped_anatomy(AVERAGE, side, shape)
    np.testing.assert_allclose(shape_between(AVERAGE, other).factors, shape.factors, rtol=1e-12)


def test_the_configuration_s_hand() -> None:
    settings = HandSettings(side="left", scale=0.9, finger_widths=(1.0, 1.1, 1.0, 1.0, 1.0), palm_length=1.1)
    made = hand_model(settings)
    expected = average_hand("left", HandShape(0.9, finger_widths=(1.0, 1.1, 1.0, 1.0, 1.0), palm_length=1.1))
    np.testing.assert_array_equal(made.smooth.vertices, expected.smooth.vertices)
    assert len(made.skin("fine").triangles) == 4 * len(made.skin("medium").triangles)
    assert made.skin("lean") is made.lean


@pytest.mark.parametrize(
    "values",
    [
        {"palm_width": 0.5},
        {"finger_widths": [1.0] * 4},
        {"wrist_width": 2.0},
        {"thumb_place": 3.0},
        {"coefficients": [0.0, 1.01 * MOST_COEFFICIENT]},
        {"coefficients": [-1.01 * MOST_COEFFICIENT]},
        {"coefficients": [0.0] * (COEFFICIENTS + 1)},
        {"coefficients": 1.0},
    ],
)
def test_shapes_that_fold_are_refused(values: dict[str, object]) -> None:
    with pytest.raises(UsageError, match=next(iter(values))):
        validated(HandSettings, values, "hand.toml")


def test_a_hand_from_a_file_has_no_coefficients() -> None:
    """The modes are of the hand that is shipped: refused, as nothing would be done with them."""
    with pytest.raises(UsageError, match=r"^hand.toml: 'mesh' cannot be used, found 'a.glb'.*coefficients"):
        validated(HandSettings, {"mesh": "a.glb", "coefficients": [0.5]}, "hand.toml")
    assert validated(HandSettings, {"mesh": "a.glb", "coefficients": []}, "hand.toml").mesh == "a.glb"


def test_a_file_of_factors_is_read_as_ever() -> None:
    """What former calibrations wrote, sixteen factors, is a shape still: of the average hand's bones."""
    former = {
        "side": "left",
        "scale": 0.95,
        "finger_lengths": [1.0, 1.1, 1.0, 0.9, 1.0],
        "finger_widths": [1.0] * 5,
        "palm_width": 1.05,
        "palm_length": 1.0,
        "palm_thickness": 1.0,
        "wrist_width": 0.9,
        "thumb_place": 1.2,
    }
    hand = hand_model(validated(HandSettings, former, "hand.toml")).anatomy
    lengths = 0.95 * np.array(former["finger_lengths"])[:, None]
    np.testing.assert_allclose(hand.segments, lengths * AVERAGE.segments)
    assert hand.is_left and hand.wrist == 0.9


def test_coefficients_of_the_configuration_reach_the_hand() -> None:
    made = hand_model(HandSettings(coefficients=(0.5, -1.5), scale=1.1))
    expected = average_hand("right", HandShape(1.1, coefficients=(0.5, -1.5)))
    np.testing.assert_array_equal(made.smooth.vertices, expected.smooth.vertices)
    assert np.abs(made.anatomy.segments - 1.1 * AVERAGE.segments).max() > 1.0
