"""What frames tell of a person: of views without noise, in the end all there is to know."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from posetrack_cli.geometry.rotations import head_quaternion_from_roll_pitch_yaw
from posetrack_cli.head.adjustment import adjuster as adjusting
from posetrack_cli.head.adjustment.adjuster import Adjuster, PersonParameters, PointView
from posetrack_cli.head.config import AdjustmentSettings
from posetrack_cli.head.face.points import HeadPose
from posetrack_cli.head.tracker.person import IdentityHistory, KnownPerson, new_person, rms
from support.bundles import CAMERA, UNIT_SD, Bundle, random_bundle, random_model
from support.mono_cases import assert_same, random_templates

SEEDS = range(6)
N_VIEWS = 10
EXACT = AdjustmentSettings(views=N_VIEWS, prior=1e-3, offsets=False, pixel_sd=UNIT_SD, average=1)
"""Nearly least squares."""
USUAL = AdjustmentSettings(views=N_VIEWS)
NOTHING = 1e-3
"""Of a shape, 0.1 mm of 100 mm: what a prior of a thousandth leaves, far below what one frame leaves."""


def at_rest(seed: int, count: int = 20) -> Bundle:
    """Views of a random face that does not deform: deformation and identity cannot stand for each other."""
    model = random_model(seed)
    still = replace(model, deformation_deviations=1e-4 * model.deformation_deviations)
    return random_bundle(seed, count, model=still, spread=1.5)


def adjuster(bundle: Bundle, settings: AdjustmentSettings) -> Adjuster:
    return Adjuster(bundle.model, CAMERA, settings)


def found(bundle: Bundle, settings: AdjustmentSettings) -> KnownPerson:
    person = PersonParameters(bundle.model.identity_mean, np.zeros((10, 3)))
    return new_person(person, random_templates(0), adjuster(bundle, settings))


def as_tracked(bundle: Bundle, index: int) -> PointView:
    """A view as a filter has it: not quite where the head is."""
    view, rng = bundle.views[index], np.random.default_rng(index)
    tangent = rng.uniform(-1.0, 1.0, 6) * [8.0, 8.0, 20.0, 0.06, 0.06, 0.06]
    return replace(view, pose=view.pose.moved(tangent), deformation=bundle.model.deformation_mean)


def after(bundle: Bundle, settings: AdjustmentSettings, count: int) -> list[KnownPerson]:
    """What is known when the person was found and after each of some frames."""
    known = [found(bundle, settings)]
    for index in range(count):
        view = as_tracked(bundle, index)
        known.append(known[-1].after(view, 0.9, adjuster(bundle, settings)))
    return known


def unlike(known: KnownPerson, bundle: Bundle) -> float:
    """Distance from the true face, less what one camera cannot tell: its size (and place).

    Sine of the angle between both shapes as vectors after the best turn (Procrustes).
    """
    true = bundle.model.of_person(bundle.person.identity).mean
    one, other = (shape - shape.mean(axis=0) for shape in (known.shape.mean, true))
    product = (one / np.linalg.norm(one)).T @ (other / np.linalg.norm(other))
    return float(np.sqrt(max(0.0, 1.0 - np.linalg.svd(product, compute_uv=False).sum() ** 2)))


@pytest.mark.parametrize("seed", SEEDS)
def test_a_person_comes_nearer_frame_after_frame(seed: int) -> None:
    bundle = at_rest(seed)
    away = [unlike(known, bundle) for known in after(bundle, EXACT, 8)]
    assert all(later < max(earlier, NOTHING) for earlier, later in pairwise(away))
    assert away[-1] < NOTHING < 0.03 < away[0]


@pytest.mark.parametrize("seed", SEEDS)
def test_with_priors_and_offsets_too_but_for_what_they_hold(seed: int) -> None:
    """Points count a quarter of what they err by in a frame: n views say eight times as much as priors."""
    bundle = at_rest(seed)
    away = [unlike(known, bundle) for known in after(bundle, USUAL, 20)]
    assert away[-1] < away[0] / 8.0


def test_views_end_with_the_frame_adjusted() -> None:
    bundle = at_rest(0)
    for index, known in enumerate(after(bundle, EXACT, 14)[1:]):
        last = known.views[-1]
        assert last.stamp_ns == bundle.views[index].stamp_ns
        np.testing.assert_array_equal(last.pixels, bundle.views[index].pixels)
        assert len(known.views) == min(index + 1, N_VIEWS)
        assert known.adjusted_frames == index + 1
    # the size that one camera cannot tell moves a head along its ray: only the turn is known exactly
    assert np.abs(bundle.views[13].pose.difference(last.pose)[3:]).max() < NOTHING
    assert known.rms_px < 0.01


def test_views_are_chosen_by_the_spread_that_is_asked_for() -> None:
    """Faces near a pole of yaw, where directions and angles choose others (``test_views``)."""
    bundle, stamps = at_rest(0), {}
    poses = [(50.0, 75.0), (0.0, 40.0), (0.0, 75.0)]
    turned = [
        replace(as_tracked(bundle, index), pose=HeadPose(bundle.views[0].pose.position, quaternion))
        for index, quaternion in enumerate(
            head_quaternion_from_roll_pitch_yaw(np.radians([0.0, pitch, yaw])) for yaw, pitch in poses
        )
    ]
    for spread in ("directions", "angles"):
        settings = USUAL.model_copy(update={"views": 2, "spread": spread})
        known = replace(found(bundle, settings), views=tuple(turned[:2]))
        after_it = known.after(turned[2], 0.9, adjuster(bundle, settings))
        stamps[spread] = [one.stamp_ns for one in after_it.views]
    first, second, new = (one.stamp_ns for one in turned)
    assert stamps == {"directions": [second, new], "angles": [first, new]}


@pytest.mark.parametrize("average", [1, 4])
def test_the_history_holds_the_last_identities(average: int) -> None:
    bundle = at_rest(1)
    people = after(bundle, EXACT.model_copy(update={"average": average}), 7)
    wanted = [known.person.identity for known in people[-average:]]
    np.testing.assert_array_equal(people[-1].history.identities, wanted)


def test_the_mean_of_the_last_identities_is_where_an_adjustment_begins(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """(4.36): with a box about the start that is as good as closed, it stays there."""
    bundle, history = at_rest(1), USUAL.model_copy(update={"average": 4})
    known = after(bundle, history, 7)[-1]
    monkeypatch.setattr(adjusting, "IDENTITY_STEP", 1e-6)
    last = known.after(as_tracked(bundle, 7), 0.9, adjuster(bundle, history))
    box = 1e-6 * bundle.model.identity_deviations
    assert np.all(np.abs(last.person.identity - known.history.mean) <= 1.001 * box)
    assert np.any(np.abs(known.person.identity - known.history.mean) > 10.0 * box)


def test_a_frame_leaves_what_was_known_before_as_it_was() -> None:
    bundle = at_rest(2)
    before, same = after(bundle, USUAL, 3)[-1], after(bundle, USUAL, 3)[-1]
    before.after(as_tracked(bundle, 3), 0.9, adjuster(bundle, USUAL))
    before.adjusted_over_album(adjuster(bundle, USUAL))
    assert_same(before, same)


@pytest.mark.parametrize("seed", SEEDS)
def test_over_all_frames_the_person_comes_nearer_still(seed: int) -> None:
    bundle = at_rest(seed)
    known = after(bundle, USUAL, 20)[-1]
    adjusted_over_album = known.adjusted_over_album(adjuster(bundle, USUAL))
    assert unlike(adjusted_over_album, bundle) < unlike(known, bundle)


@pytest.mark.parametrize("seed", SEEDS)
def test_over_all_frames_no_cost_grows(seed: int) -> None:
    """F of the album with the person held, of a face that deforms, before and after."""
    bundle = random_bundle(seed, 20)
    known = after(bundle, USUAL, 20)[-1]
    adjusted_over_album = known.adjusted_over_album(adjuster(bundle, USUAL))

    def cost(person: PersonParameters) -> float:
        held = {"iterations": 50, "hold_person": True, "wide": True}
        closely = adjuster(bundle, USUAL).over_recording
        return closely.adjust(known.album.views, person, **held).cost

    assert cost(adjusted_over_album.person) <= cost(known.person)


def test_over_all_frames_begins_a_second_pass() -> None:
    """Nothing is kept of frames that the second pass sees again."""
    bundle = at_rest(3)
    known = after(bundle, USUAL, 12)[-1]
    adjusted_over_album = known.adjusted_over_album(adjuster(bundle, USUAL))
    assert adjusted_over_album.views == () and adjusted_over_album.album.views == ()
    assert_same(
        adjusted_over_album.history,
        IdentityHistory.starting_with(adjusted_over_album.person.identity, USUAL.average),
    )
    assert adjusted_over_album.templates is known.templates and adjusted_over_album.adjusted_frames == 12
    np.testing.assert_array_equal(
        adjusted_over_album.shape.mean,
        bundle.model.of_person(adjusted_over_album.person.identity, adjusted_over_album.person.offsets).mean,
    )


@pytest.mark.parametrize("when", ["start", "never"])
def test_a_person_who_is_not_adjusted_stays(when: str) -> None:
    bundle = at_rest(4)
    known = after(bundle, USUAL, 5)[-1]
    assert known.adjusted_over_album(adjuster(bundle, USUAL.model_copy(update={"when": when}))) is known


def test_one_frame_is_not_adjusted_over_album() -> None:
    bundle = at_rest(5)
    known = after(bundle, USUAL, 1)[-1]
    assert known.adjusted_over_album(adjuster(bundle, USUAL)) is known


def test_rms_is_of_the_known_distances() -> None:
    assert rms(np.array([[3.0, np.nan], [4.0, np.nan]])) == pytest.approx(np.sqrt(12.5))
    assert np.isnan(rms(np.array([np.nan, np.nan])))


# The history of identities is the last N_s of them


@given(st.integers(0, 1000), st.integers(1, 20), st.integers(1, 6))
def test_keeps_the_last_ones(seed, count, size):
    identities = np.random.default_rng(seed).normal(size=(count, 4))
    history = IdentityHistory.starting_with(identities[0], size)
    for one in identities[1:]:
        history = history.with_identity(one)
    last = identities[-size:]
    np.testing.assert_array_equal(history.identities, last)
    np.testing.assert_array_equal(history.mean, last.mean(axis=0))
    np.testing.assert_array_equal(history.spread, last.std(axis=0))


def test_adding_leaves_the_history_before_as_it_was():
    before = IdentityHistory.starting_with(np.ones(3), 2)
    before.with_identity(np.zeros(3)).with_identity(np.full(3, 5.0))
    np.testing.assert_array_equal(before.identities, np.ones((1, 3)))
    np.testing.assert_array_equal(before.spread, 0.0)


def test_does_not_change_with_the_array_that_it_began_with():
    identity = np.ones(3)
    history = IdentityHistory.starting_with(identity, 2)
    identity[:] = 7.0
    np.testing.assert_array_equal(history.mean, np.ones(3))
