"""What patches say about a point: derivatives of E against differences of E itself."""

from __future__ import annotations

import numpy as np
import pytest

from posetrack_cli.head.config import RefinementSettings
from posetrack_cli.head.face.rig_images import RigImages
from posetrack_cli.head.face.templates import GRID, SIZE, normalise, sample_grid, take_templates
from posetrack_cli.head.refinement.evidence import (
    BETWEEN_CAMERAS,
    PREVIOUS,
    REFERENCE,
    ComparedFrame,
    comparison_weight,
    gather_evidence,
    make_evidence,
    make_workspace,
    project_point,
)
from support.textured_face import FACING, SHAPE, stereo, textured_face

ONLY = {"reference": 0.0, "previous": 0.0, "between_cameras": 0.0}
MOVED = np.array([1.0, -0.8, 2.0])
HARDLY = 1e-12
"""Weight of the stored templates beside that of the frame before, 1: for what they say of likeness alone."""


def scene_of(previous_likeness=0.0, **weights):
    """A scene whose comparisons have other weights, and are believed with a precision of 1."""
    cameras = stereo()
    images = textured_face().render(cameras, FACING, SHAPE)
    seen = RigImages(cameras, images)
    templates = take_templates(seen, FACING, SHAPE)
    settings, weights = RefinementSettings(previous_likeness=previous_likeness), ONLY | weights
    scene, _ = ComparedFrame(seen, [templates], templates, settings).scene(FACING, SHAPE)
    scene.targets.weights[0] *= weights["reference"] / REFERENCE
    scene.targets.weights[1] *= weights["previous"] / PREVIOUS
    scene.targets.pair_weights[:] *= weights["between_cameras"] / BETWEEN_CAMERAS
    return scene._replace(robustness=scene.robustness._replace(precision=1.0))


def evidence_at(scene, k, X):
    out = make_evidence(2)
    gather_evidence(scene, k, X, make_workspace(2), out)
    return out


def patch(scene, c, k, X, warp):
    """The patch of point k at X on camera c, by itself."""
    pixel, J, grid, values = np.empty(2), np.empty((2, 3)), np.empty((GRID, GRID)), np.empty(SIZE)
    assert project_point(scene.optics, c, k, X, pixel, J)
    u, v = pixel - scene.images.corners[c]
    assert sample_grid(scene.images.windows[c], *scene.images.sizes[c], u, v, warp, grid)
    normalise(grid, values)
    return values


def cost(scene, k, X, weights_at):
    """E(X) from its definition, with the weights that hold at another point."""
    total, upright = 0.0, np.eye(2)
    for c in range(2):
        for s in range(len(scene.targets.patches)):
            weight = scene.targets.weights[s, c, k]
            if weight > 0.0:
                q = scene.targets.patches[s, c, k]
                w = weight * comparison_weight(scene.robustness, patch(scene, c, k, weights_at, upright) @ q)
                total += 0.5 * w * np.sum((patch(scene, c, k, X, upright) - q) ** 2)
    weight, warp = scene.targets.pair_weights[0, k], scene.targets.pair_warps[0, k]
    if weight > 0.0:
        there = patch(scene, 1, k, weights_at, upright) @ patch(scene, 0, k, weights_at, warp)
        difference = patch(scene, 1, k, X, upright) - patch(scene, 0, k, X, warp)
        total += 0.5 * weight * comparison_weight(scene.robustness, there) * np.sum(difference**2)
    return total


@pytest.mark.parametrize("term", ["reference", "previous", "between_cameras"])
@pytest.mark.parametrize("k", [0, 4, 9])
def test_gradient_is_the_difference_of_the_cost(term, k):
    scene, h = scene_of(**{term: 2.0}), 0.4
    X = FACING.points(SHAPE)[k] + MOVED
    found = evidence_at(scene, k, X).gradient
    wanted = [(cost(scene, k, X + step, X) - cost(scene, k, X - step, X)) / (2 * h) for step in h * np.eye(3)]
    # central differences of pixels damp waves of 12 px by (2 pi / 12)^2 / 6 = 5 %; 8 bits, bending
    assert np.linalg.norm(found - wanted) < 0.1 * np.linalg.norm(wanted)


def test_terms_add_up():
    k, X = 3, FACING.points(SHAPE)[3] + MOVED
    apart = [evidence_at(scene_of(**{name: 2.0}), k, X) for name in ONLY]
    together = evidence_at(scene_of(**dict.fromkeys(ONLY, 2.0)), k, X)
    np.testing.assert_allclose(together.hessian, sum(one.hessian for one in apart))
    np.testing.assert_allclose(together.gradient, sum(one.gradient for one in apart))


def test_where_the_templates_were_taken_nothing_pulls():
    scene = scene_of(reference=1.0, previous=1.0)
    out = evidence_at(scene, 5, FACING.points(SHAPE)[5])
    np.testing.assert_allclose(out.gradient, 0.0, atol=1e-9)
    np.testing.assert_allclose(out.correlations, 1.0, atol=1e-12)
    assert np.linalg.eigvalsh(out.hessian).min() > 0.0  # and two cameras see a point from all sides


def test_one_camera_does_not_see_depth():
    scene = scene_of(reference=1.0)
    scene.targets.weights[:, 1] = 0.0
    X = FACING.points(SHAPE)[2]
    hessian = evidence_at(scene, 2, X).hessian
    assert X @ hessian @ X < 1e-9 * np.trace(hessian) * (X @ X)
    assert np.isnan(evidence_at(scene, 2, X).correlations[1])


@pytest.mark.parametrize(
    "ncc, wanted",
    [(1.0, 1.0), (0.6, 0.5**6), (0.2, 0.0), (-0.5, 0.0)],
    ids=["same", "half", "floor", "below"],
)
def test_belief_falls_with_the_sixth_power_above_the_floor(ncc, wanted):
    assert comparison_weight(scene_of().robustness, ncc) == pytest.approx(wanted)


def like_stored(scene, k, X, ncc):
    """The scene with stored templates that hardly pull, and correlate so with the patches at X."""
    rng, upright = np.random.default_rng(k), np.eye(2)
    for c in range(2):
        now = patch(scene, c, k, X, upright)
        other = rng.normal(size=SIZE)
        other -= other.mean() + (other @ now) * now
        other /= np.linalg.norm(other)
        scene.targets.patches[0, c, k] = ncc * now + np.sqrt(1.0 - ncc**2) * other
        scene.targets.weights[0, c, k] = HARDLY
    return scene


@pytest.mark.parametrize("power", [0.5, 1.0, 2.0])
@pytest.mark.parametrize("ncc", [0.8, 0.5, 0.0, -0.4])
def test_the_frame_before_pulls_as_the_point_is_like_its_stored_templates(power, ncc):
    k = 4
    X = FACING.points(SHAPE)[k] + MOVED
    whole = evidence_at(like_stored(scene_of(previous=1.0, previous_likeness=0.0), k, X, ncc), k, X)
    found = evidence_at(like_stored(scene_of(previous=1.0, previous_likeness=power), k, X, ncc), k, X)
    np.testing.assert_allclose(found.correlations, ncc, atol=1e-12)
    share = max(ncc, 0.0) ** power
    scale = np.linalg.norm(whole.hessian), np.linalg.norm(whole.gradient)
    assert min(scale) > 1e-6  # a point is known to many mm at least: it does pull
    np.testing.assert_allclose(found.hessian, share * whole.hessian, atol=1e-6 * scale[0])
    np.testing.assert_allclose(found.gradient, share * whole.gradient, atol=1e-6 * scale[1])


def test_without_a_stored_template_the_frame_before_pulls_fully():
    k = 4
    X = FACING.points(SHAPE)[k] + MOVED
    some, none = (evidence_at(scene_of(previous=1.0, previous_likeness=power), k, X) for power in (2.0, 0.0))
    assert np.isnan(some.correlations).all()
    np.testing.assert_array_equal(some.hessian, none.hessian)
    assert np.linalg.norm(some.hessian) > 0.0


def test_likeness_does_not_touch_the_stored_templates():
    k = 4
    X = FACING.points(SHAPE)[k] + MOVED
    some, none = (evidence_at(scene_of(reference=1.0, previous_likeness=power), k, X) for power in (2.0, 0.0))
    np.testing.assert_array_equal(some.gradient, none.gradient)
    assert np.linalg.norm(some.gradient) > 0.0


def test_cameras_with_images_are_compared_with_each_other_whichever_is_missing():
    cameras = stereo(3)
    images = textured_face().render(cameras, FACING, SHAPE)
    templates = take_templates(RigImages(cameras, images), FACING, SHAPE)
    for missing, pairs in ((None, [[1, 0], [2, 0], [2, 1]]), (0, [[2, 1]]), (2, [[1, 0]])):
        there = [None if c == missing else image for c, image in enumerate(images)]
        scene, _ = ComparedFrame(RigImages(cameras, there), [templates], None, RefinementSettings()).scene(
            FACING, SHAPE
        )
        np.testing.assert_array_equal(scene.targets.pairs, pairs)
