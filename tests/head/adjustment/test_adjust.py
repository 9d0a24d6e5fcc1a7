"""The adjustment as a whole: it finds what is there, never makes it worse, and stays in its bounds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as examples
from hypothesis import strategies as st
from scipy.optimize import least_squares

from posetrack_cli.geometry.camera import pixels_from_points
from posetrack_cli.geometry.rotations import head_roll_pitch_yaw
from posetrack_cli.head.actions import displacement
from posetrack_cli.head.adjustment import adjuster
from posetrack_cli.head.adjustment.adjuster import (
    DEFORMATION_STEP,
    IDENTITY_STEP,
    STEP,
    Adjuster,
    PersonParameters,
    PointView,
    clipped,
)
from posetrack_cli.head.adjustment.problem import cost
from posetrack_cli.head.config import AdjustmentSettings
from posetrack_cli.head.face.points import HeadPose
from posetrack_cli.head.multilinear.face_model import load_face_model
from support.adjustment_reference import Case, joined, numeric_jacobian, residual_vector, split
from support.bundles import FREE, LENSES, moved_away, noisy, random_bundle

EPS = np.finfo(np.float64).eps
seeds = st.integers(0, 2**32 - 1)
MANY = 1000
"""Iterations after which nothing moves any more."""


def run(case, iterations=5, **how):
    return case.adjuster.adjust(case.views, case.person, iterations=iterations, **how)


def case_of(seed, settings=None, count=5, noise=0.7, away=1.0, lens="no lens"):
    bundle = noisy(random_bundle(seed, count, LENSES[lens], offset_mm=1.0), noise, seed)
    views, person = moved_away(bundle, seed, away)
    return Case(views, person, bundle.model, bundle.camera, settings or AdjustmentSettings())


def with_outliers(case, rng, share=0.2, px=40.0):
    views = []
    for view in case.views:
        wrong = rng.uniform(size=10) < share
        views.append(replace(view, pixels=view.pixels + px * wrong[:, None] * rng.normal(size=(10, 2))))
    return replace(case, views=tuple(views))


def cost_at(case, views, person):
    at = replace(case, views=views, person=person)
    return cost(at.problem, at.start, at.everything)


def start_cost(case, wide=False):
    start = case.start
    boxes = case.adjuster.boxes(start, wide)
    return cost(case.problem, clipped(start, boxes), case.everything)


def proportional(found, wanted):
    """An identity times the factor that takes it nearest to another: without priors s and a have none."""
    return found * (found @ wanted) / (found @ found)


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("seed", range(5))
def test_recovers_the_person_from_noiseless_views(seed, lens):
    bundle = random_bundle(seed, 6, LENSES[lens])
    views, person = moved_away(bundle, seed)
    found = Adjuster(bundle.model, bundle.camera, FREE).adjust(views, person, iterations=MANY, wide=True)
    identity = proportional(found.person.identity, bundle.person.identity)
    assert np.abs(identity - bundle.person.identity).max() < 1e-6
    for one, true in zip(found.views, bundle.views, strict=True):
        shape = bundle.model.shapes(found.person.identity, one.deformation)
        np.testing.assert_allclose(
            shape, bundle.model.shapes(bundle.person.identity, true.deformation), atol=1e-5
        )
        np.testing.assert_allclose(true.pose.difference(one.pose), 0.0, atol=1e-4)
    assert np.nanmax(found.residuals) < 1e-6


@given(seeds, st.floats(0.0, 4.0), st.booleans(), st.booleans(), st.integers(1, 4))
@examples(max_examples=40)
def test_cost_never_rises(seed, away, wide, hold, iterations):
    rng = np.random.default_rng(seed)
    case = with_outliers(case_of(seed % 1000, away=away, count=int(rng.integers(1, 7))), rng)
    found = run(case, iterations, wide=wide, hold_person=hold)
    if not hold:
        assert found.cost <= start_cost(case, wide) * (1.0 + 8.0 * EPS)
    further = run(case, iterations + 1, wide=wide, hold_person=hold)
    assert np.isfinite(found.cost)
    before = cost_at(case, found.views, found.person)
    assert before == pytest.approx(found.cost, rel=1e-9)
    again = run(replace(case, views=found.views, person=found.person), 1, wide=wide, hold_person=hold)
    assert again.cost <= found.cost * (1.0 + 1e-9)  # whitening there and back is what it costs
    assert further.iterations >= found.iterations


@given(seeds, st.floats(0.0, 6.0), st.booleans(), st.booleans())
@examples(max_examples=40)
def test_bounds_are_never_broken(seed, away, wide, hold):
    case = with_outliers(case_of(seed % 1000, away=away, count=4), np.random.default_rng(seed))
    settings, model = case.settings, case.model
    found = run(case, 4, wide=wide, hold_person=hold)
    tiny = 1e-9  # of units of order one, taken out of their whitening and back
    for one, start in zip(found.views, case.views, strict=True):
        v = (one.deformation - model.deformation_mean) / model.deformation_deviations
        v0 = (start.deformation - model.deformation_mean) / model.deformation_deviations
        assert np.abs(v).max() <= settings.bound + tiny
        if not wide:
            moved = np.abs(start.pose.difference(one.pose))
            assert np.all(moved <= STEP + tiny)
            inside = np.clip(v0, -settings.bound, settings.bound)
            assert np.abs(v - inside).max() <= DEFORMATION_STEP + tiny
    if hold:
        return
    u = (found.person.identity - model.identity_mean) / model.identity_deviations
    u0 = (case.person.identity - model.identity_mean) / model.identity_deviations
    assert np.abs(u).max() <= settings.bound + tiny
    if not wide:
        inside = np.clip(u0, -settings.bound, settings.bound)
        assert np.abs(u - inside).max() <= IDENTITY_STEP + tiny


LINEAR = AdjustmentSettings(huber=1e6)
TIGHT = {"IDENTITY_STEP": 0.1, "DEFORMATION_STEP": 0.2, "STEP": np.array([2.0, 2.0, 5.0, 0.03, 0.03, 0.03])}
"""Boxes that the way to the optimum leads out of."""


@pytest.mark.parametrize(
    "seed, settings, lens, boxes",
    [
        (0, LINEAR, "no lens", {}),
        (1, AdjustmentSettings(), "no lens", {}),
        (1, AdjustmentSettings(), "plumb bob", TIGHT),
    ],
    ids=["linear", "huber", "tight with a lens"],
)
def test_agrees_with_scipys_bounded_least_squares(monkeypatch, seed, settings, lens, boxes):
    for name, reach in boxes.items():
        monkeypatch.setattr(adjuster, name, reach)
    case = case_of(seed, settings, count=2, lens=lens)
    if settings is not LINEAR:
        case = with_outliers(case, np.random.default_rng(seed), 0.1, 10.0)
    found = run(case, MANY)
    start, part = case.start, case.everything
    boxes = Adjuster(case.model, case.camera, settings).boxes(start, wide=False)
    lower = np.concatenate([boxes.local_lower.ravel(), boxes.shared_lower])
    upper = np.concatenate([boxes.local_upper.ravel(), boxes.shared_upper])

    def function(x):
        return residual_vector(case, split(x, start))

    theirs = least_squares(
        function,
        np.clip(joined(start, part), lower, upper),
        lambda x: numeric_jacobian(function, x),
        bounds=(lower, upper),
        x_scale="jac",
        ftol=1e-15,
        xtol=1e-15,
        gtol=1e-10,
        max_nfev=500,
    )
    at_bound = np.sum((theirs.x - lower < 1e-6) | (upper - theirs.x < 1e-6))
    assert settings is not TIGHT or at_bound > 5
    # Theirs stays inside and stops where a step gains 1e-15 F; its bounds are reached to 1e-8 or so, at a
    # slope of up to 1e2 a unit: 1e-6 in F in all.
    assert found.cost <= theirs.cost + 1e-9 * theirs.cost
    assert found.cost >= theirs.cost - 1e-5
    # about its minimum F grows by prior/2 |du|^2 at least, prior = 2: |du|^2 is at most what F differs by
    at = replace(case, views=found.views, person=found.person).start
    u = theirs.x[start.local.size :][:10]
    assert np.sum((at.shared[:10] - u) ** 2) <= 1e-5


def test_order_of_views_changes_nothing():
    case = case_of(21)
    order = [3, 0, 4, 2, 1]
    one = run(case, MANY)
    two = run(replace(case, views=tuple(case.views[i] for i in order)), MANY)
    assert two.cost == pytest.approx(one.cost, rel=1e-10)
    np.testing.assert_allclose(two.person.identity, one.person.identity, atol=1e-6)
    np.testing.assert_allclose(two.residuals, one.residuals[order], atol=1e-5)


def test_equal_runs_give_equal_bits():
    one, two = run(case_of(22)), run(case_of(22))
    assert one.cost == two.cost
    np.testing.assert_array_equal(one.person.identity, two.person.identity)


def test_a_gross_outlier_moves_little():
    case = case_of(23)
    pixels = case.views[2].pixels.copy()
    pixels[5] += [60.0, -45.0]
    wrong = replace(case, views=(*case.views[:2], replace(case.views[2], pixels=pixels), *case.views[3:]))
    right, robust = run(case, MANY, wide=True), run(wrong, MANY, wide=True)
    squares = replace(wrong, settings=LINEAR)
    misled = run(squares, MANY, wide=True)

    def away(found):
        return np.linalg.norm(
            (found.person.identity - right.person.identity) / case.model.identity_deviations
        )

    # the influence of a point 50 sd off is bounded to that of one 3 sd off
    assert away(robust) < 0.2 * away(misled)
    assert robust.residuals[2, 5] > 60.0
    assert np.sqrt(np.nanmean(np.delete(robust.residuals.ravel(), 25) ** 2)) < 2.0


def test_a_held_person_stays_to_the_bit():
    case = case_of(24)
    far = replace(case, person=PersonParameters(case.person.identity * 9.0, case.person.offsets + 1.0))
    found = run(far, hold_person=True)
    np.testing.assert_array_equal(found.person.identity, far.person.identity)
    np.testing.assert_array_equal(found.person.offsets, far.person.offsets)
    np.testing.assert_array_equal(found.identity_deviations, case.model.identity_deviations)


def test_views_of_a_held_person_do_not_see_each_other():
    case = case_of(25)
    together = run(case, hold_person=True)
    for i in range(5):
        alone = run(replace(case, views=case.views[i : i + 1]), hold_person=True)
        np.testing.assert_array_equal(alone.views[0].deformation, together.views[i].deformation)
        np.testing.assert_array_equal(alone.views[0].pose.position, together.views[i].pose.position)


def test_offsets_stay_where_they_are_not_sought():
    case = case_of(26, AdjustmentSettings(offsets=False))
    case = replace(case, person=replace(case.person, offsets=np.full((10, 3), 0.7)))
    found = run(case)
    np.testing.assert_allclose(found.person.offsets, 0.7, rtol=1e-14)
    assert np.abs(found.person.identity - case.person.identity).max() > 1e-3


@pytest.mark.parametrize("lost", ["weight 0", "NaN pixel", "infinite pixel", "NaN weight"])
def test_points_without_weight_or_pixel_are_left_out(lost):
    case = case_of(27, lens="plumb bob")
    view, other = case.views[1], case.views[1]
    pixels, weights = view.pixels.copy(), view.weights.copy()
    weights[3] = 0.0
    view = replace(view, weights=weights, pixels=pixels)
    pixels, weights = pixels.copy(), view.weights.copy()
    if "pixel" in lost:
        pixels[3], weights[3] = (np.nan if lost == "NaN pixel" else np.inf), 1.0
    elif lost == "NaN weight":
        weights[3] = np.nan
    other = replace(view, pixels=pixels, weights=weights)
    one = run(replace(case, views=(case.views[0], view, *case.views[2:])))
    two = run(replace(case, views=(case.views[0], other, *case.views[2:])))
    np.testing.assert_array_equal(two.person.identity, one.person.identity)
    assert np.isnan(two.residuals[1, 3]) and np.isfinite(np.delete(two.residuals.ravel(), 13)).all()


def test_a_view_without_any_point_stays_where_it_is():
    case = case_of(28)
    view = replace(case.views[0], weights=np.zeros(10))
    found = run(replace(case, views=(view, *case.views[1:])))
    np.testing.assert_allclose(view.pose.difference(found.views[0].pose), 0.0, atol=1e-12)


def test_a_start_behind_the_camera_ends_without_nan():
    case = case_of(29)
    pose = replace(case.views[0].pose, position=np.array([0.0, 0.0, -500.0]))
    found = run(replace(case, views=(replace(case.views[0], pose=pose), *case.views[1:])), wide=True)
    assert found.cost == np.inf
    assert np.isfinite(found.person.identity).all() and not np.isnan(found.residuals).any()


def test_residuals_are_distances_of_recorded_pixels():
    case = case_of(30, lens="plumb bob")
    found = run(case, MANY)
    for one, residuals in zip(found.views, found.residuals, strict=True):
        shape = case.model.shapes(found.person.identity, one.deformation) + found.person.offsets
        pixels, _ = pixels_from_points(case.camera, one.pose.points(shape))
        # the lens's second derivative: 1e-3 a pixel here, times the square of a pixel or two
        np.testing.assert_allclose(np.linalg.norm(pixels - one.pixels, axis=1), residuals, atol=5e-3)


def test_more_iterations_are_taken_only_while_they_help():
    case = case_of(31)
    assert run(case, 0).iterations == 0
    assert run(case, 1).iterations == 2
    assert run(case, MANY).iterations < 2 * MANY
    assert run(case, MANY).cost <= run(case, 5).cost


def test_a_mouth_that_goes_aside_turns_no_head():
    """With deformations that only symmetric faces show it was taken for 9 degrees of yaw."""
    model, camera = load_face_model(), LENSES["no lens"]
    person = PersonParameters(model.identity_mean, np.zeros_like(model.mean))
    neutral = model.shapes(model.identity_mean, model.deformation_mean)
    pose = HeadPose(np.array([0.0, 0.0, 700.0]), np.array([1.0, 0.0, 0.0, 0.0]))
    pixels, _ = pixels_from_points(camera, pose.points(neutral + 0.7 * displacement("mouth_left")))
    view = PointView(0, pixels, np.ones(len(pixels)), pose, model.deformation_mean)
    closely = Adjuster(model, camera, AdjustmentSettings()).over_recording
    found = closely.adjust([view], person, iterations=20, hold_person=True, wide=True).views[0]
    yaw = np.degrees(head_roll_pitch_yaw(found.pose.quaternion)[2] - head_roll_pitch_yaw(pose.quaternion)[2])
    assert abs(yaw) < 1.0  # the prior of the mouth leaves some of it


def test_over_a_recording_points_err_less_alike():
    case = case_of(0)
    closely, share = case.adjuster.over_recording, case.adjuster.settings.whole_share
    np.testing.assert_allclose(closely.problem(case.views).scales * share, case.problem.scales)
