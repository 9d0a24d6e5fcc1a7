"""Eyes look where the truth says, and lids close over them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry.camera import pixels_from_points
from posetrack_cli.geometry.rigid import in_object
from posetrack_cli.head.dense.numbers import CLOSED, TRUE_NUMBERS
from posetrack_cli.head.face.points import HeadPose
from posetrack_cli.rendering.port import RenderingDevice
from posetrack_cli.synthesis.head import eyes
from posetrack_cli.synthesis.head.eyes import LOOKING_AHEAD, MOST_RAD, OpenEye, gazes_at, lid_opening_mm
from posetrack_cli.synthesis.head.form import along_and_above, eye_places
from posetrack_cli.synthesis.head.frames import Scene, make_plan, render_plan
from posetrack_cli.synthesis.head.options import HeadSynthOptions
from posetrack_cli.synthesis.head.person import BALL_MM, FaceSurface, Identity, Looks

EYEBALLS = np.array([[-31.0, 1.0, -9.0], [31.0, 1.0, -9.0]])
POSES = np.array([[10.0, -5.0, 700.0, 1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 650.0, 0.9987, 0.0, 0.05, 0.0]])
POSES[:, 3:] /= np.linalg.norm(POSES[:, 3:], axis=1, keepdims=True)


def direction(side: float, up: float) -> FloatArray:
    return np.array([np.sin(side) * np.cos(up), np.sin(up), np.cos(side) * np.cos(up)])


def test_eye_coordinates_are_undone() -> None:
    s, above = np.array([0.1, 0.5, 0.9]), np.array([-2.0, 0.0, 4.0])
    for side in (-1.0, 1.0):
        np.testing.assert_allclose(along_and_above(*eye_places(s, above, side)), (s, above), atol=1e-12)


def test_both_eyes_look_at_the_same_place() -> None:
    """Lines of sight meet; little aside they meet at the target: tanh(a) = a - a^3 / 3."""
    targets = np.array([[15.0, 5.0, 20.0], [-300.0, 100.0, 0.0]])
    gazes = gazes_at(targets, POSES, EYEBALLS)
    for gaze, target, pose in zip(gazes, in_object(targets, POSES[:, :3], POSES[:, 3:]), POSES, strict=True):
        across = np.cross(gaze[0], gaze[1])
        apart = (EYEBALLS[1] - EYEBALLS[0]) @ across / np.linalg.norm(across)
        assert abs(apart) < 1e-9
        length = np.linalg.lstsq(gaze.T * [1.0, -1.0], EYEBALLS[1] - EYEBALLS[0], rcond=None)[0][0]
        met = EYEBALLS[0] + length * gaze[0]
        middle = EYEBALLS.mean(axis=0)
        assert np.linalg.norm(met - middle) == pytest.approx(np.linalg.norm(target - middle))
        if abs(target[0]) < 100.0:
            np.testing.assert_allclose(met, target, atol=2.0)
        turn = np.arccos((met - middle)[2] / np.linalg.norm(met - middle))
        assert turn < MOST_RAD < np.pi
        assert pose[2] > 0.0


def test_lids_close_and_follow_the_gaze_upwards() -> None:
    surface, looks = FaceSurface(Identity()), Looks()
    usual = lid_opening_mm(surface, looks, 0, LOOKING_AHEAD)
    assert usual == pytest.approx(lid_opening_mm(surface, looks, 1, LOOKING_AHEAD))
    half, closed = (lid_opening_mm(surface, looks, 0, LOOKING_AHEAD._replace(closing=c)) for c in (0.5, 1.0))
    assert closed == pytest.approx(0.0, abs=1e-9)
    # the chord of half an arc is longer than half the chord
    assert half == pytest.approx(0.5 * usual, rel=0.05)
    down, up = (lid_opening_mm(surface, looks, 0, OpenEye(direction(0.0, a))) for a in (-0.2, 0.2))
    assert down < usual < up


@pytest.mark.parametrize(("side", "up", "yaw"), [(0.0, 0.0, 0.0), (0.3, -0.1, 0.4), (-0.25, 0.15, -0.3)])
def test_the_iris_is_drawn_where_its_sphere_is(
    side: float, up: float, yaw: float, device: RenderingDevice, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A bright spot in place of the pupil, seen from aside; it is shaded. .2 mm are 1 deg of the sphere."""

    def spot(self: eyes._PaintedEye, s: FloatArray, gaze: FloatArray) -> FloatArray:
        return np.where(BALL_MM * np.linalg.norm(self._directions - gaze, axis=-1) < 1.0, 1.0, 0.0)

    monkeypatch.setattr(eyes._PaintedEye, "_ball", spot)
    monkeypatch.setattr(eyes, "GLOSS", 0.0)
    options = HeadSynthOptions(cameras=1, frames=1, distance_mm=400.0, light="steady")
    plan = make_plan(options)
    camera, gaze = plan.cameras[0], direction(side, up)
    turned = np.array([np.cos(yaw / 2.0), 0.0, np.sin(yaw / 2.0), 0.0])
    pose = HeadPose(np.array([0.0, 0.0, 400.0]), turned)
    size = (camera.width, camera.height)
    rest = HeadPose(plan.movement.origin, plan.movement.rest)
    scene = Scene(device, plan.person, plan.identity.looks, plan.grid, size, rest, plan.scenery)
    scene.set(pose, np.zeros(8), (OpenEye(gaze), OpenEye(gaze)), None)
    image = scene.renderer.image(camera, plan.illumination.at(0.0))
    scene.release()
    expected, _ = pixels_from_points(camera, pose.points(plan.person.surface.eyeballs + BALL_MM * gaze))
    for place in expected:
        x, y = np.rint(place).astype(int)
        rows, columns = np.mgrid[y - 6 : y + 7, x - 6 : x + 7]
        bright = np.clip(image[rows, columns] - 0.5 * image[rows, columns].max(), 0.0, None)
        found = np.array([(bright * columns).sum(), (bright * rows).sum()]) / bright.sum()
        np.testing.assert_allclose(found, place, atol=0.2 * camera.fx / 400.0)


def test_the_truth_has_gazes_and_blinks(device: RenderingDevice) -> None:
    options = HeadSynthOptions(cameras=1, frames=45, fps=9.0, width=160, height=120, seed=1)
    frames = list(render_plan(make_plan(options), device=device))
    numbers = np.array([frame.truth().numbers for frame in frames])
    named = dict(zip(TRUE_NUMBERS, numbers.T, strict=True))
    openings = np.stack([named[f"action_{side}_lid_open"] for side in ("right", "left")])
    np.testing.assert_array_equal(named[CLOSED], openings.mean(axis=0) < 0.5)
    blink = np.array([frame.strengths[-1] for frame in frames])
    assert blink.max() > 0.5 and (named[CLOSED][blink > 0.7] == 1.0).all()
    for side in ("right", "left"):
        in_camera = np.stack([named[f"{side}_gaze_{axis}"] for axis in "xyz"], axis=1)
        in_head = in_object(in_camera, np.zeros(3), np.array([frame.pose.quaternion for frame in frames]))
        angles = named[f"{side}_gaze_to_left_rad"], named[f"{side}_gaze_up_rad"]
        np.testing.assert_allclose(in_head, direction(*angles).T, atol=1e-9)
    still = make_plan(replace(options, expressions=False))
    assert still.script.target is None
