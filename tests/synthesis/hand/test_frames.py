from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from posetrack_cli.hand.model.anatomy import make_anatomy
from posetrack_cli.rendering.port import RenderingDevice
from posetrack_cli.synthesis.hand.frames import (
    CAMERA,
    MISSING_FRACTIONS,
    SyntheticHandFrame,
    make_plan,
    synthesise,
)
from posetrack_cli.synthesis.hand.options import Switches, SynthOptions

BARE = Switches()


def frames(device: RenderingDevice, **options: Any) -> list[SyntheticHandFrame]:
    return list(synthesise(SynthOptions(**{"switches": BARE, "frames": 4, **options}), device=device))


def first(device: RenderingDevice, **options: Any) -> SyntheticHandFrame:
    return frames(device, frames=1, **options)[0]


def test_a_frame_has_depth_truth_and_stamp(device: RenderingDevice) -> None:
    made = frames(device, motion="C")
    assert [frame.index for frame in made] == [0, 1, 2, 3]
    assert all(frame.depth.shape == (424, 512) and frame.depth.dtype == np.uint16 for frame in made)
    assert np.diff([frame.stamp_ns for frame in made]).tolist() == pytest.approx([1e9 / 30.0] * 3, abs=1.0)


CENTRED_MM = 4.0
"""A joint lies so near to the middle of its finger: people's do to a few millimetres."""
TIPS = np.arange(4, 21, 4)
INNER = np.setdiff1d(np.arange(21), TIPS)


@pytest.mark.parametrize(("motion", "side"), [("A", "right"), ("B", "left"), ("C", "right")])
def test_true_joints_lie_in_the_rendered_hand(device: RenderingDevice, motion: str, side: str) -> None:
    for frame in frames(device, motion=motion, side=side, frames=60, seed=2)[::6]:
        pixels, _ = CAMERA.pixels_from_points(frame.joints)
        u, v = np.rint(pixels).astype(int).T
        depth = frame.depth.astype(float)
        for k in TIPS:  # on the skin itself, so maybe just outside its pixels
            assert depth[v[k] - 2 : v[k] + 3, u[k] - 2 : u[k] + 3].any()
        assert (depth[v[INNER], u[INNER]] > 0.0).all()
        assert (depth[v[INNER], u[INNER]] < frame.joints[INNER, 2]).all()  # the skin is before the joint


@pytest.mark.parametrize("motion", ["A", "C"])
@pytest.mark.parametrize("side", ["right", "left"])
def test_joints_of_an_open_hand_are_a_finger_radius_below_the_skin(
    device: RenderingDevice, motion: str, side: str
) -> None:
    frame = first(device, motion=motion, side=side)
    pixels, _ = CAMERA.pixels_from_points(frame.joints)
    u, v = np.rint(pixels).astype(int).T
    below = (frame.joints[:, 2] - frame.depth[v, u]).reshape(-1)
    radii = make_anatomy(side).radii
    for finger in range(1, 5):  # PIP and DIP; the joints before them lie in the palm
        assert below[[2 + 4 * finger, 3 + 4 * finger]] == pytest.approx(radii[finger, 1:3], abs=CENTRED_MM)


def test_the_hand_covers_as_many_pixels_as_a_real_one(device: RenderingDevice) -> None:
    """hand.md: 4000 to 5500 px at 0.6 to 0.7 m."""
    assert 4000 < np.count_nonzero(first(device, motion="C").depth) < 5500


def test_left_is_the_mirror_image_of_right(device: RenderingDevice) -> None:
    everything = replace(Switches.all_on(), noise=False, edges=False)
    for switches in (BARE, everything):
        right = first(device, motion="B", switches=switches).depth.astype(int)
        left = first(device, motion="B", side="left", switches=switches).depth.astype(int)
        # a rasteriser decides pixels on an edge differently from left and from right
        assert (np.abs(right - left[:, ::-1]) > 1).mean() < 0.002


def test_body_forearm_and_background_add_pixels(device: RenderingDevice) -> None:
    bare = first(device, motion="C").depth
    forearm = first(device, motion="C", switches=replace(BARE, forearm=True)).depth
    body = first(device, motion="C", switches=replace(BARE, body=True)).depth
    both = first(device, motion="C", switches=replace(BARE, body=True, forearm=True)).depth
    room = first(device, motion="C", switches=replace(BARE, background=True)).depth
    hand = bare > 0
    for depth in (forearm, body, both, room):
        assert (depth[hand] == bare[hand]).mean() > 0.98  # but for where the forearm covers the wrist
    assert 1500 < np.count_nonzero(forearm[~hand]) < 8000
    behind = body[~hand & (body > 0)]
    assert behind.size > 20000
    assert 250.0 < np.percentile(behind, 5) - np.median(bare[hand]) < 420.0
    assert np.count_nonzero(both) > np.count_nonzero((forearm > 0) | (body > 0))  # the upper arm
    assert (room > 0).all() and room[~hand].min() > 1500


def test_the_forearm_leaves_no_gap_at_the_wrist(device: RenderingDevice) -> None:
    import cv2

    for frame in frames(device, motion="C", frames=90, seed=1, switches=replace(BARE, forearm=True))[::9]:
        parts, _ = cv2.connectedComponents((frame.depth > 0).astype(np.uint8))
        assert parts == 2  # nothing, and one piece


def test_noise_and_edges_do_what_they_say(device: RenderingDevice) -> None:
    clean = first(device, motion="C", switches=replace(BARE, background=True)).depth.astype(float)
    noise = first(device, motion="C", switches=replace(BARE, background=True, noise=True)).depth
    edges = first(device, motion="C", switches=replace(BARE, background=True, edges=True)).depth
    error = noise - clean
    centre = error[60:140, 220:290]  # wall between ceiling and hand, 2.7 m
    assert 1.3 < centre.std() < 2.3
    assert 0.7 < error[(clean > 600) & (clean < 700)].std() < 1.5
    lost = edges == 0
    assert 500 < lost.sum() < 12000
    assert (edges[~lost] == clean[~lost]).all() and (clean[lost] > 1500).all()


def test_drops_make_gaps_and_late_frames_shift_stamps(device: RenderingDevice) -> None:
    options = SynthOptions(motion="A", frames=200, seed=1, switches=replace(BARE, drops=True, late=True))
    plan = make_plan(options)
    written = np.flatnonzero(plan.written)
    assert 0 < plan.timeline.dropped.sum() < 20
    some = list(synthesise(replace(options, frames=60), device=device))
    assert [frame.index for frame in some] == list(range(len(some)))
    assert np.diff([frame.stamp_ns for frame in some]).min() > 0
    assert len(written) == 200 - plan.timeline.dropped.sum()


def test_the_pose_of_a_late_frame_is_that_of_its_stamp() -> None:
    late = make_plan(SynthOptions(motion="C", frames=200, switches=replace(BARE, late=True)))
    plain = make_plan(SynthOptions(motion="C", frames=200, switches=BARE))
    moved = late.timeline.stamps_ns != plain.timeline.stamps_ns
    assert moved.any() and not moved.all()
    assert (late.motion.poses[~moved] == plain.motion.poses[~moved]).all()
    assert plain.motion.twists is not None
    delay = (late.timeline.seconds - plain.timeline.seconds)[:, None]
    way = late.motion.poses[:, :3] - plain.motion.poses[:, :3]
    # a parabola's remainder: 1/2 (15 ms)^2 times at most 1.5e4 mm/s^2
    assert np.abs(way - delay * plain.motion.twists[:, :3]).max() < 0.5 * 0.015**2 * 1.5e4


def test_switches_of_the_sensor_change_no_pose() -> None:
    plain = make_plan(SynthOptions(motion="A", switches=BARE))
    rest = make_plan(SynthOptions(motion="A", switches=replace(Switches.all_on(), late=False)))
    assert (plain.motion.poses == rest.motion.poses).all()


def test_missing_fractions_beside_a_hand_are_as_measured(device: RenderingDevice) -> None:
    import cv2

    lost, count = np.zeros(9), np.zeros(9)
    switches = replace(BARE, background=True, edges=True)
    seen = frames(device, motion="C", frames=40, seed=3, switches=switches)
    bare = frames(device, motion="C", frames=40, seed=3)
    for frame, hand in zip(seen, bare, strict=True):
        outside = cv2.distanceTransform((hand.depth == 0).astype(np.uint8), cv2.DIST_L2, 5)
        for k in range(1, 9):
            ring = np.rint(outside) == k
            lost[k] += (frame.depth[ring] == 0).sum()
            count[k] += ring.sum()
    # rings of whole pixels blur a steep curve, and a hand's edges do not face all ways alike
    assert lost[1:] / count[1:] == pytest.approx(MISSING_FRACTIONS, abs=0.08)
