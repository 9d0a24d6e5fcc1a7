from __future__ import annotations

import numpy as np

from posetrack_cli.head.face.points import (
    MEAN_SHAPE,
    MIRRORED,
    POINT_COUNT,
    POINT_NAMES,
    SHAPE_SD,
    ShapeModel,
    rigid_model,
)


def test_shapes_are_the_mean_and_what_each_coefficient_adds() -> None:
    rng = np.random.default_rng(0)
    basis, coefficients = rng.standard_normal((POINT_COUNT, 3, 2)), rng.standard_normal((4, 7, 2))
    model = ShapeModel(MEAN_SHAPE, basis, np.array([2.0, 1.0]))
    for index in np.ndindex(4, 7):
        first, second = coefficients[index]
        expected = MEAN_SHAPE + first * basis[:, :, 0] + second * basis[:, :, 1]
        np.testing.assert_allclose(model.shapes(coefficients)[index], expected)
        np.testing.assert_allclose(model.shapes(coefficients[index]), expected)


def test_a_rigid_face_is_its_mean() -> None:
    model = rigid_model(MEAN_SHAPE)
    assert model.size == 0
    np.testing.assert_array_equal(model.shapes(np.zeros((5, 0))), np.tile(MEAN_SHAPE, (5, 1, 1)))


def test_the_mean_face_is_its_own_mirror_image() -> None:
    np.testing.assert_array_equal(MEAN_SHAPE[list(MIRRORED)], MEAN_SHAPE * [-1.0, 1.0, 1.0])
    np.testing.assert_array_equal(SHAPE_SD[list(MIRRORED)], SHAPE_SD)
    for name, other in zip(POINT_NAMES, MIRRORED, strict=True):
        assert POINT_NAMES[other] == name.replace("right", "L").replace("left", "right").replace("L", "left")


def test_the_origin_is_the_middle_of_the_eye_corners() -> None:
    np.testing.assert_allclose(MEAN_SHAPE[:4].mean(axis=0), 0.0, atol=0.05)  # figures are rounded to 0.1 mm
