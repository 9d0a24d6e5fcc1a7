"""Where faces are searched for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from posetrack_cli.geometry.camera import pixels_from_points
from posetrack_cli.head.config import DetectionSettings
from posetrack_cli.head.detection.detector import FaceDetector
from posetrack_cli.head.detection.search import ROTATIONS, quick_ways, thorough_ways, tile_of
from posetrack_cli.rendering.port import RenderingDevice
from posetrack_cli.synthesis.head.form import Sway
from posetrack_cli.synthesis.head.frames import make_cameras, make_plan, render_plan
from posetrack_cli.synthesis.head.options import HeadSynthOptions


def test_quick_searches_add_up_to_the_thorough_one() -> None:
    cycle = range(4 * len(ROTATIONS))
    ways = {way._replace(area=0.0) for index in cycle for way in quick_ways(index)}
    assert ways == {way._replace(area=0.0) for way in thorough_ways(None) if not way.again}
    assert all(quick_ways(index)[0].is_usual for index in cycle)


@pytest.mark.parametrize("shape", [(1080, 1920), (481, 640), (720, 1280)])
def test_tiles_cover_a_large_image(shape: tuple[int, int]) -> None:
    seen, index = np.zeros(shape, bool), 0
    while not seen.all():
        assert index < 100
        part = tile_of(shape, index)
        assert part is not None
        seen[part] = True
        index += 1


def test_small_images_have_no_tiles() -> None:
    assert tile_of((480, 640), 3) is None


def turned_head(yaw: float, roll: float, device: RenderingDevice) -> tuple[np.ndarray, np.ndarray]:
    """An image of a head with a yaw and a roll, deg, and its points (K, 2), pixels."""
    options = HeadSynthOptions(cameras=1, frames=1, roll=roll, identity=3, expressions=False)
    plan = make_plan(options)
    held = np.zeros((6, 1))
    held[3] = np.radians(yaw)
    movement = replace(plan.movement, sway=Sway(held, np.zeros((6, 1)), np.full((6, 1), np.pi / 2.0)))
    late = replace(plan.timeline, stamps_ns=np.array([2_000_000_000]))  # after the onset of motion
    (frame,) = render_plan(replace(plan, movement=movement, timeline=late), device=device)
    assert frame.images[0] is not None
    pixels, _ = pixels_from_points(make_cameras(options)[0], frame.pose.points(frame.shape))
    return frame.images[0], pixels


@pytest.mark.parametrize(("yaw", "roll"), [(50.0, 0.0), (-45.0, 0.0), (0.0, 90.0), (0.0, 180.0)])
@pytest.mark.parametrize("points", ["learned", "corners"])
def test_turned_and_rolled_heads_are_found(
    device: RenderingDevice, yaw: float, roll: float, points: str
) -> None:
    """Eyes and mouth that are not hidden lie within a tenth of the eye distance, 90 pixels."""
    image, truth = turned_head(yaw, roll, device)
    (face,) = FaceDetector(DetectionSettings(points=points)).detect(image).faces  # type: ignore[arg-type]
    seen = face.responses[:6] > 0.0
    assert seen.sum() >= 4
    assert np.median(np.linalg.norm(face.pixels - truth, axis=1)[:6][seen]) < 9.0
