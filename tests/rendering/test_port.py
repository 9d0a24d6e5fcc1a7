"""Two implementations of the renderers' port draw and sum alike, and a hand run asks for nothing else."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from posetrack_cli.errors import RenderingError
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.hand.model.anatomy import make_anatomy
from posetrack_cli.hand.model.hand import hand_mesh
from posetrack_cli.hand.model.kinematics import skinning_transforms
from posetrack_cli.hand.run import HandRun, RunOptions
from posetrack_cli.hand.start import scattered_poses
from posetrack_cli.rendering import cpu as cpu_tiled
from posetrack_cli.rendering.cpu import CpuDevice
from posetrack_cli.rendering.pixel_model import PixelMixture
from posetrack_cli.rendering.port import Comparison, RenderingDevice, TileSums, Window, sums_in_numpy
from posetrack_cli.results.reader import read_result
from support.hand import KINECT
from support.hand_scene import HANDS, Drawn, Stage, pose_file, relaxed
from support.numpy_renderer import NumpyDevice
from support.rendering import CAMERA, moved, sphere

TILE, STEP, COUNT = 32, 5, 3
CONFIG = HandConfig.model_validate(
    {
        "hand": {"side": "right"},
        "output": {"mesh": "none"},
        "filter": {"particles": 8},
        "observation": {"tile_px": TILE},
    }
)
JOINT_MM = 5.0
"""Of a hand seen with noise of 3 mm, as coarsely as here."""
OUTLINE_PIXELS = 3
"""So many rays through an edge may be rounded to either side of it, in a tile."""
DEPTH_MM = 0.1
SUMS_RELATIVE = 1e-4
"""Float32 sums of a thousand terms."""
ROUNDING = 1e-4
"""Float32 depth, of which a difference of 1 mm is compared with 1e-4."""
MISFIT_RELATIVE = 0.02
"""A pixel at the outline is 7 of a sum of some 500."""


@pytest.fixture(scope="module")
def hands() -> np.ndarray:
    anatomy = make_anatomy()
    return skinning_transforms(anatomy, scattered_poses(anatomy, COUNT, np.random.default_rng(2)))


def window() -> Window:
    return Window.around(np.array([KINECT.cx, KINECT.cy]), TILE, STEP)


def test_hands_are_drawn_alike(fast_device: RenderingDevice, hands: np.ndarray) -> None:
    mesh = hand_mesh(make_anatomy())
    first, second = (
        one.depth_renderer(mesh, (TILE, TILE)).depth(hands, KINECT, window())
        for one in (fast_device, NumpyDevice())
    )
    different = (first > 0) != (second > 0)
    assert different.sum() <= COUNT * OUTLINE_PIXELS
    assert (first > 0).sum(axis=(1, 2)).min() > 100
    inner = ~different & (np.abs(first - second) < 5.0)  # but for edges of fingers before others
    assert (~inner).sum() <= 2 * COUNT * OUTLINE_PIXELS
    np.testing.assert_allclose(first[inner], second[inner], atol=DEPTH_MM)


def test_hands_are_summed_alike(fast_device: RenderingDevice, hands: np.ndarray) -> None:
    mesh = hand_mesh(make_anatomy())
    drawing = [one.depth_renderer(mesh, (TILE, TILE)) for one in (fast_device, NumpyDevice())]
    depth = drawing[1].depth(hands[:1], KINECT, window())[0]
    observed = np.where(depth > 0, depth + 4.0, -1500.0).astype(np.float32)
    observed[:3] = 0.0
    first, second = (
        one.sums(hands, KINECT, window(), Comparison(observed, 40.0, PixelMixture(), match_mm=10.0))
        for one in drawing
    )
    assert first.observed == second.observed > 100
    for name in ("both", "rendered_only", "unread", "occluded", "matched"):
        np.testing.assert_allclose(
            getattr(first, name), getattr(second, name), atol=OUTLINE_PIXELS, err_msg=name
        )
    np.testing.assert_allclose(first.error, second.error, atol=40.0 * OUTLINE_PIXELS, rtol=SUMS_RELATIVE)
    np.testing.assert_allclose(first.misfit, second.misfit, rtol=MISFIT_RELATIVE)


def test_sums_are_those_of_the_depth_that_is_drawn(hands: np.ndarray) -> None:
    """Of the processor: the same depth, so nothing but rounding differs from the sums in numpy."""
    drawing = CpuDevice().depth_renderer(hand_mesh(make_anatomy()), (TILE, TILE))
    depth = drawing.depth(hands, KINECT, window())
    rng = np.random.default_rng(3)
    noisy = depth[0] + rng.normal(0.0, 6.0, depth[0].shape)
    observed = np.where(rng.random(depth[0].shape) < 0.2, 0.0, np.where(depth[0] > 0, noisy, -700.0))
    for model in (None, PixelMixture()):
        comparison = Comparison(observed.astype(np.float32), 40.0, model, match_mm=10.0)
        found = drawing.sums(hands, KINECT, window(), comparison)
        expected = sums_in_numpy(depth, comparison, STEP / KINECT.fx)
        for field in fields(TileSums):
            np.testing.assert_allclose(
                getattr(found, field.name), getattr(expected, field.name), rtol=ROUNDING, err_msg=field.name
            )


def test_sums_do_not_depend_on_the_number_of_cores(
    hands: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    comparison = Comparison(np.full((TILE, TILE), 600.0, dtype=np.float32), 40.0, PixelMixture())
    found = []
    for cores in (1, 2, 5):
        monkeypatch.setattr(cpu_tiled, "thread_count", lambda cores=cores: cores)
        drawing = CpuDevice().depth_renderer(hand_mesh(make_anatomy()), (TILE, TILE))
        found.append(drawing.sums(hands, KINECT, window(), comparison))
    for name in ("error", "misfit", "relief"):
        first, *others = (getattr(one, name).tobytes() for one in found)
        assert others == [first, first]


def test_both_refuse_what_does_not_fit(any_device: RenderingDevice) -> None:
    drawing = any_device.depth_renderer(sphere(50.0, 1), (16, 16), 2)
    seen = Window(0, 0, 1, 16, 16)
    for shape in ((2, 2, 3, 4), (2, 1, 4, 4), (2, 3, 4)):
        with pytest.raises(RenderingError, match="bone transforms do not fit"):
            drawing.depth(np.zeros(shape, dtype=np.float32), CAMERA, seen)
    with pytest.raises(RenderingError, match="window does not fit the tile"):
        drawing.depth(moved((0, 0, 400)), CAMERA, Window(0, 0, 1, 16, 17))
    for asked, image in ((seen, (16, 17)), (seen, (256,)), (Window(0, 0, 1, 8, 32), (32, 8))):
        with pytest.raises(RenderingError, match="does not fit"):
            drawing.sums(
                moved((0, 0, 400)), CAMERA, asked, Comparison(np.zeros(image, dtype=np.float32), 40.0)
            )


def test_a_hand_run_needs_nothing_but_the_port(device: RenderingDevice, tmp_path: Path) -> None:
    stage, path = Stage(device, HANDS["right"]), tmp_path / "r.mcap"
    poses = [relaxed(x=5.0 * k) for k in range(3)]
    options = RunOptions(path, init=str(pose_file(tmp_path / "start.json", poses[0])))
    HandRun(Drawn.of(stage, poses), CONFIG, options, NumpyDevice()).track(lambda estimate: None)
    result = read_result(path)
    assert result.run["renderer"] == f"numpy, numpy {np.__version__}"
    found = result.columns(fields=("position", "quaternion", "shape"))
    estimated = np.hstack([found["position"], found["quaternion"], found["shape"]])
    assert max(stage.error(e, p) for e, p in zip(estimated, poses, strict=True)) < JOINT_MM
