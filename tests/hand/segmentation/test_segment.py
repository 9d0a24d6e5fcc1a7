"""The hand's pixels around a prediction: an analytic scene, and laws."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from posetrack_cli.hand.config import ObservationSettings
from posetrack_cli.hand.model.anatomy import JOINT_NAMES, make_anatomy
from posetrack_cli.hand.model.hand import hand_mesh
from posetrack_cli.hand.model.kinematics import mirrored_poses, skinning_transforms
from posetrack_cli.hand.observe import segmentation
from posetrack_cli.hand.observe.observation import PixelSampler, window_around
from posetrack_cli.hand.observe.prediction import PredictedHand
from posetrack_cli.hand.observe.segmentation import Label, Segmentation, segment
from posetrack_cli.rendering.port import RenderingDevice, Window
from posetrack_cli.synthesis.hand.shapes import SHAPES
from support.hand import KINECT, REST

ANATOMY, LEFT = make_anatomy(), make_anatomy("left")
WALL_MM, ARM_MM, FACE_MM = 1500.0, 630.0, 900.0
WRIST_Y_MM = 60.0
MESH_END_MM = 13.0
"""Behind the wrist joint the hand's skin ends."""
PIXEL_MM = 3.75
"""Of the window; slices are about as long."""
SAMPLER = PixelSampler(KINECT)


class Scene:
    """A drawn hand with a forearm below it, a wall and a face behind, a blob beside it and some holes."""

    def __init__(self, device: RenderingDevice) -> None:
        self.pose = posed()
        self.hand = PredictedHand.of(ANATOMY, self.pose)
        self.window = window_around(
            self.hand.joints, KINECT, ObservationSettings(tile_px=96, window_mm=340.0)
        )
        self.drawn = drawn_hand(device, self.pose)
        self.is_hand = self.drawn > 0
        x, y = across_at(ARM_MM)
        below = (y > WRIST_Y_MM + MESH_END_MM) & ~self.is_hand
        # as wide as the wrist there, wider towards the elbow
        self.is_arm = below & (np.abs(x) < 25.0 + 0.1 * (y - WRIST_Y_MM))
        self.is_seam = (np.abs(x) < 25.0) & (y > WRIST_Y_MM - 5.0) & ~below & ~self.is_hand
        self.is_blob = (np.abs(x + 95.0) < 12.0) & (np.abs(y - 30.0) < 15.0) & ~self.is_hand
        self.depth = np.full(self.drawn.shape, WALL_MM, dtype=np.float32)
        u, v = np.meshgrid(np.arange(512.0), np.arange(424.0))
        self.is_face = np.hypot(u - 240.0, v - 180.0) < 40.0
        self.depth[self.is_face] = FACE_MM
        self.depth[self.is_arm | self.is_blob | self.is_seam] = ARM_MM
        self.depth[self.is_hand] = self.drawn[self.is_hand]
        self.is_hole = np.random.default_rng(1).random(self.depth.shape) < 0.05
        self.depth[self.is_hole] = 0.0

    def told(self, hand: PredictedHand | None = None) -> Segmentation:
        return segment(self.depth, SAMPLER, self.window, KINECT, hand or self.hand)

    def in_window(self, mask: np.ndarray) -> np.ndarray:
        return SAMPLER.sample(mask, self.window) > 0

    def moved(self, x: float, y: float, z: float) -> PredictedHand:
        pose = self.pose.copy()
        pose[:3] += [x, y, z]
        return PredictedHand.of(ANATOMY, pose)


def posed(angles: np.ndarray | float = 0.0) -> np.ndarray:
    """A hand (22,) before the sensor, its finger angles (15,), rad."""
    pose = REST.copy()
    pose[:3], pose[7:] = [0.0, WRIST_Y_MM, 650.0], angles
    return pose


def drawn_hand(device: RenderingDevice, pose: np.ndarray) -> np.ndarray:
    renderer = device.depth_renderer(hand_mesh(ANATOMY, "fine"), (512, 424), 1)
    return renderer.depth(skinning_transforms(ANATOMY, pose[None]), KINECT, Window.whole(KINECT))[0].copy()


def across_at(z: float) -> tuple[np.ndarray, np.ndarray]:
    """x and y (mm) of every pixel of a plane that faces the camera."""
    u, v = np.meshgrid(np.arange(512.0), np.arange(424.0))
    return (u - KINECT.cx) / KINECT.fx * z, (v - KINECT.cy) / KINECT.fy * z


@pytest.fixture(scope="module")
def scene(device: RenderingDevice) -> Scene:
    return Scene(device)


def test_hand_forearm_wall_face_and_blob_are_told_apart(scene: Scene) -> None:
    told = scene.told()
    read = ~scene.in_window(scene.is_hole)
    wrist_row = scene.window.rows()[:, None] < KINECT.cy + KINECT.fy * WRIST_Y_MM / 650.0
    palm = scene.in_window(scene.is_hand) & read & wrist_row
    assert (told.labels[palm] == Label.HAND).all()
    arm = scene.in_window(scene.is_arm) & read
    assert arm.sum() > 60
    assert (told.labels[arm] == Label.FOREARM).mean() > 0.95  # the seam lies within a pixel, 3.75 mm
    for other in (scene.is_face, scene.is_blob):
        mask = scene.in_window(other & ~scene.is_hand) & read
        assert mask.sum() > 10
        assert (told.labels[mask] == Label.OTHER).all()
    assert (told.labels[~read] == Label.UNREAD).all()


def test_the_observation_keeps_what_the_likelihood_reads(scene: Scene) -> None:
    told = scene.told()
    tile, image = SAMPLER.sample(scene.depth, scene.window), told.observation.image
    for label, sign in ((Label.HAND, 1.0), (Label.OTHER, -1.0), (Label.FOREARM, 0.0), (Label.UNREAD, 0.0)):
        mask = told.is_labelled(label)
        assert mask.any()
        np.testing.assert_array_equal(image[mask], sign * tile[mask])
    assert told.observation.target_pixels == (image > 0).sum()


def test_a_missing_reading_is_no_background(scene: Scene) -> None:
    """A hand that is a sieve stays one hand: single missing readings part no surface."""
    told, holes = scene.told(), scene.in_window(scene.is_hole & scene.is_hand)
    assert holes.sum() > 20
    np.testing.assert_array_equal(told.observation.image[holes], 0.0)
    whole = replace_depth(scene, np.where(scene.is_hole & scene.is_hand, scene.drawn, scene.depth))
    both = ~scene.in_window(scene.is_hole)
    limbs = [np.isin(of.labels[both], (Label.HAND, Label.FOREARM)) for of in (whole, told)]
    assert (limbs[0] != limbs[1]).sum() <= 2  # beside a hole in the seam of hand and arm
    # widths with and without the holes tell the wrist, and the cut through the limb, to parts of a pixel
    assert np.linalg.norm(whole.wrist - told.wrist) < 0.5 * PIXEL_MM
    assert (whole.labels[both] != told.labels[both]).sum() <= 0.5 * 50.0 / PIXEL_MM  # half a row of the wrist


def replace_depth(scene: Scene, depth: np.ndarray) -> Segmentation:
    return segment(depth.astype(np.float32), SAMPLER, scene.window, KINECT, scene.hand)


@pytest.mark.parametrize("slide_mm", [-25.0, 25.0])
def test_the_wrist_comes_from_the_image(scene: Scene, slide_mm: float) -> None:
    """A prediction that slid along the arm does not take the cut along."""
    told = scene.told(scene.moved(0.0, slide_mm, 0.0))
    assert told.arm is not None
    np.testing.assert_allclose(told.arm, [0.0, -1.0, 0.0], atol=0.1)
    assert abs(told.wrist[1] - WRIST_Y_MM) < 2.0 * PIXEL_MM
    assert abs(scene.told().wrist[1] - WRIST_Y_MM) < 2.0 * PIXEL_MM


def test_wherever_along_the_arm_a_hand_is_predicted_the_wrist_is_the_same(scene: Scene) -> None:
    """No slide is more alike than others because rows of pixels then fall into slices alike."""
    slides = np.arange(-28.0, 29.0, 4.0)
    found = np.array([scene.told(scene.moved(0.0, slide, 0.0)).wrist[1] for slide in slides])
    # the prior takes a few per cent of a slide along, and a slice is told from its neighbour by a parabola
    assert np.abs(found - np.median(found)).max() < 0.5 * PIXEL_MM + 0.05 * slides.max()
    assert np.polyfit(slides, found, 1)[0] < 0.1


def test_without_a_forearm_nothing_is_cut(scene: Scene) -> None:
    told = replace_depth(scene, scene.drawn)
    assert told.arm is None
    hand = scene.in_window(scene.is_hand)
    np.testing.assert_array_equal(told.is_labelled(Label.HAND), hand)


@pytest.mark.parametrize(
    "offset", [(15.0, 0.0, 0.0), (0.0, 0.0, 25.0), (0.0, 0.0, -25.0), (-10.0, 10.0, 10.0)]
)
def test_a_prediction_that_is_somewhat_off_finds_the_same_hand(
    scene: Scene, offset: tuple[float, float, float]
) -> None:
    told, usual = scene.told(scene.moved(*offset)), scene.told()
    both, either = (
        f(told.labels == Label.HAND, usual.labels == Label.HAND) for f in (np.logical_and, np.logical_or)
    )
    assert both.sum() > 0.95 * either.sum()


@pytest.mark.parametrize("margin", ["_ASIDE_MM", "_IN_FRONT_MM", "_BEHIND_MM"])
def test_each_margin_holds_something_back(scene: Scene, monkeypatch: pytest.MonkeyPatch, margin: str) -> None:
    usual = scene.told().observation.target_pixels
    monkeypatch.setattr(segmentation, margin, 1e-3)
    assert scene.told().observation.target_pixels < usual


def test_a_hand_that_touches_a_body_is_cut_out_of_it(scene: Scene) -> None:
    """The body goes on from the hand without a jump; what is not beside the prediction is not the hand."""
    body = np.where(scene.is_hand, scene.drawn, 655.0).astype(np.float32)
    told = replace_depth(scene, body)
    hand = scene.in_window(scene.is_hand)
    assert (told.labels[hand] == Label.HAND).mean() > 0.8
    outside_px = cv2.distanceTransform((~scene.is_hand).astype(np.uint8), cv2.DIST_L2, 5)
    far = scene.in_window(outside_px > 40.0 / 650.0 * KINECT.fx)  # 20 mm, and half a bone's thickness
    assert far.any()
    assert (told.labels[far] != Label.HAND).all()


@pytest.mark.parametrize(("is_finger", "is_followed"), [(True, True), (False, True), (True, False)])
def test_a_finger_that_stretches_behind_missing_readings_is_seen(
    device: RenderingDevice, scene: Scene, is_finger: bool, is_followed: bool
) -> None:
    """A fist is expected, and nothing links the pointing finger to it. A stick that goes on is no finger.

    Nor is anything one of a fist that may not be there.
    """
    pose = posed(SHAPES["one"])
    hand, drawn = PredictedHand.of(ANATOMY, pose), drawn_hand(device, pose)
    knuckle, joint, tip = (hand.joints[JOINT_NAMES.index(f"index_{name}")] for name in ("mcp", "pip", "tip"))
    x, y = across_at(float(joint[2]))
    beyond = (y < knuckle[1] - 15.0) & (drawn > 0)
    gap = beyond & (y > knuckle[1] - 23.0)
    depth = np.where(drawn > 0, drawn, WALL_MM)
    if not is_finger:
        beyond |= (np.abs(x - tip[0]) < 7.0) & (y < tip[1]) & (y > tip[1] - 100.0)
        depth = np.where(beyond & (drawn == 0), tip[2], depth)
    fist = PredictedHand.of(ANATOMY, posed(SHAPES["fist"]))
    image = np.where(gap, 0.0, depth).astype(np.float32)
    told = segment(image, SAMPLER, scene.window, KINECT, fist, is_followed=is_followed)
    labels = told.labels[scene.in_window(beyond & ~gap)]
    assert len(labels) > 50
    assert (labels == (Label.HAND if is_finger and is_followed else Label.OTHER)).mean() > 0.95


@pytest.mark.parametrize(("is_finger", "is_followed"), [(True, True), (False, True), (True, False)])
def test_a_finger_is_seen_of_which_nothing_lies_where_it_is_expected(
    device: RenderingDevice, scene: Scene, is_finger: bool, is_followed: bool
) -> None:
    """As one whose first half a thumb hides. A stick that goes on is none, nor is one of an unknown hand."""
    pose = posed(SHAPES["one"])
    hand, drawn = PredictedHand.of(ANATOMY, pose), drawn_hand(device, pose)
    knuckle, tip = (hand.joints[JOINT_NAMES.index(f"index_{name}")] for name in ("mcp", "tip"))
    x, y = across_at(float(tip[2]))
    beyond = (y <= knuckle[1] - 50.0) & (drawn > 0)
    along = np.where(beyond | (drawn == 0), 0.0, np.maximum(0.0, knuckle[1] - 30.0 - y))
    depth = np.where(drawn > 0, drawn - 3.0 * along, WALL_MM)  # up to 60 mm nearer, no step up to there
    if not is_finger:
        beyond |= (np.abs(x - tip[0]) < 7.0) & (y < tip[1] + 5.0) & (y > tip[1] - 110.0)
        depth = np.where(beyond & (drawn == 0), tip[2], depth)
    image = depth.astype(np.float32)
    fist = PredictedHand.of(ANATOMY, posed(SHAPES["fist"]))
    told = segment(image, SAMPLER, scene.window, KINECT, fist, is_followed=is_followed)
    labels = told.labels[scene.in_window(beyond)]
    assert len(labels) > 25
    assert (labels == (Label.HAND if is_finger and is_followed else Label.OTHER)).mean() > 0.95


def test_a_body_seen_between_two_fingers_is_no_finger(device: RenderingDevice, scene: Scene) -> None:
    """A slim piece of it within the hand's reach, beside the hand, but behind what surrounds it."""
    pose = posed(SHAPES["two"])
    hand, drawn = PredictedHand.of(ANATOMY, pose), drawn_hand(device, pose)
    starts, tips = (
        hand.joints[[JOINT_NAMES.index(f"{finger}_{name}") for finger in ("index", "middle")]]
        for name in ("pip", "tip")
    )
    x, y = across_at(float(tips[:, 2].mean()))
    gone = (starts[:, 1].mean() - y) / (starts[:, 1].mean() - tips[:, 1].mean())
    sides = np.sort(starts[:, 0] + gone[..., None] * (tips[:, 0] - starts[:, 0]), axis=-1)
    between = (gone > 0.0) & (gone < 0.7) & (x > sides[..., 0]) & (x < sides[..., 1]) & (drawn == 0)
    image = np.where(drawn > 0, drawn, WALL_MM)
    image[between] = tips[:, 2].mean() + 60.0
    told = segment(image.astype(np.float32), SAMPLER, scene.window, KINECT, hand)
    labels = told.labels[scene.in_window(between)]
    assert len(labels) > 25
    assert (labels == Label.OTHER).mean() > 0.95


def test_a_hand_close_before_a_body_is_told_by_the_step_of_its_rim(scene: Scene) -> None:
    """30 mm behind the hand's back there is a chest: within all margins, but a surface that goes on."""
    chest = np.where(scene.is_hand, scene.drawn, 700.0).astype(np.float32)
    told = replace_depth(scene, chest)
    hand = scene.in_window(scene.is_hand)
    assert (told.labels[hand] == Label.HAND).mean() > 0.98
    assert (told.labels[~hand] == Label.HAND).mean() < 0.02


def test_a_left_hand_is_told_as_its_mirror_image(scene: Scene) -> None:
    told = scene.told()
    pose = mirrored_poses(scene.pose[None])[0]
    left = PredictedHand.of(LEFT, pose)
    window = replace(
        scene.window, left=511 - scene.window.left - scene.window.step * (scene.window.width - 1)
    )
    mirrored = np.ascontiguousarray(scene.depth[:, ::-1])
    other = segment(mirrored, SAMPLER, window, KINECT.mirrored(), left)
    differing = (other.labels[:, ::-1] != told.labels).mean()
    assert differing < 0.002  # lines are drawn from pixel centres: a rim pixel may fall to the other side


def test_a_nearer_hand_larger_in_pixels_is_told_alike(scene: Scene) -> None:
    """Scaling every depth and the hand by the same factor leaves the image's rays as they are."""
    factor = 0.7
    anatomy = make_anatomy("right", factor)
    pose = scene.pose.copy()
    pose[:3] *= factor
    hand = PredictedHand.of(anatomy, pose)
    near = segment((scene.depth * factor).astype(np.float32), SAMPLER, scene.window, KINECT, hand)
    assert (near.labels != scene.told().labels).mean() < 0.01  # slices of the arm stay 4 mm long


def test_nothing_in_the_window_is_no_target(scene: Scene) -> None:
    for value in (0.0, WALL_MM):
        told = replace_depth(scene, np.full_like(scene.depth, value))
        assert told.observation.target_pixels == 0
        assert (told.labels == (Label.UNREAD if value == 0.0 else Label.OTHER)).all()


@pytest.mark.parametrize("position", [(0.0, 0.0, -300.0), (1e6, 0.0, 600.0), (0.0, 0.0, 0.5)])
def test_a_prediction_gone_astray_finds_nothing(scene: Scene, position: tuple[float, float, float]) -> None:
    pose = scene.pose.copy()
    pose[:3] = position
    told = scene.told(PredictedHand.of(ANATOMY, pose))
    assert told.labels.shape == (96, 96)
    assert told.observation.target_pixels == 0
