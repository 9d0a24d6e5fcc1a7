"""The mixture of a pixel: its density by another way, its laws, and the device's sums against loops."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import norm

from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.model.anatomy import make_anatomy
from posetrack_cli.hand.model.hand import hand_mesh
from posetrack_cli.hand.model.kinematics import skinning_transforms
from posetrack_cli.hand.start import scattered_poses
from posetrack_cli.rendering.pixel_model import PixelMixture, misfits_in_numpy, outline_distances
from posetrack_cli.rendering.port import Comparison, RenderingDevice, Window, sums_in_numpy
from support.rendering import CAMERA, STILL, moved_a_subpixel, plane, rays

MODEL = PixelMixture()
DBOT = PixelMixture(near_sd_mm=3.0, sd_mm_per_m2=1.42, outlier=0.01)
STEP = 0.002
"""The occluders' density begins at the surface: this much of a misfit is not smooth there."""
SUM_RELATIVE = 2e-4
"""Float32 sums of a thousand terms below 10, each of a depth with two roundings."""
depths = st.floats(300.0, 3000.0)


def density(model: PixelMixture, reading: float, depth: float) -> float:
    """p(y | d) as the class states it."""
    sd = model.near_sd_mm + model.sd_mm_per_m2 * (depth / 1000.0) ** 2
    rate = np.log(2.0) / model.half_life_mm
    visible = (1.0 - model.occluded - model.outlier) * norm.pdf(reading, depth, sd)
    before = rate * np.exp(-rate * reading) / (1.0 - np.exp(-rate * depth)) if reading <= depth else 0.0
    return float(visible + model.occluded * before + model.outlier / model.range_mm)


@given(depths, st.floats(-200.0, 200.0), st.sampled_from([MODEL, DBOT]))
def test_a_misfit_is_a_ratio_of_densities(depth: float, error: float, model: PixelMixture) -> None:
    expected = np.log(density(model, depth, depth) / density(model, depth + error, depth))
    found = float(model.misfit(np.array(depth), np.array(depth + error)))
    assert found == pytest.approx(expected, rel=1e-6, abs=1e-9)


@given(depths, st.sampled_from([MODEL, DBOT]))
def test_misfits_grow_to_a_bound(depth: float, model: PixelMixture) -> None:
    d, sd = np.array(depth), float(model.noise_sd(np.array(depth)))
    errors = np.linspace(0.0, 8.0 * sd, 50)
    behind, before = model.misfit(d, depth + errors), model.misfit(d, depth - errors)
    for misfits in (behind, before):
        assert abs(misfits[0]) <= STEP
        assert (np.diff(misfits[:20]) > 0).all()  # up to three standard deviations
    assert (np.diff(behind) >= -1e-12).all()
    assert behind[-1] == pytest.approx(model.unexplained(d), abs=2.0 * STEP)
    assert before[-1] < behind[-1]  # unknown things in front are not as rare as seeing through
    near = model.misfit(d, np.array(depth + 0.5 * sd))
    assert near == pytest.approx(0.125, rel=0.1)  # a square: 0.5^2 / 2


def test_the_noise_grows_with_depth() -> None:
    # dbot: 3 mm + 1.42e-3 z^2, z in metres: 4.42 mm at 1 m, 8.68 mm at 2 m
    np.testing.assert_allclose(DBOT.noise_sd(np.array([0.0, 1000.0, 2000.0])), [3.0, 4.42, 8.68])


@given(depths)
def test_other_things_in_front_say_nothing_and_behind_they_contradict(depth: float) -> None:
    d = np.array(depth)
    sd = float(MODEL.noise_sd(d))
    readings = depth + sd * np.linspace(-12.0, 12.0, 25)
    found = MODEL.misfit_of_other(d, readings, np.full(25, 1e4))
    assert found[0] < 1e-6
    assert found[12] == pytest.approx(np.log(2.0), rel=1e-2)  # as likely in front as behind
    assert found[-1] == pytest.approx(MODEL.unexplained(d), rel=1e-3)
    assert (np.diff(found) >= 0).all()


def test_an_outline_may_be_off_a_little() -> None:
    d, through = np.array(650.0), np.array(1500.0)
    off = np.array([0.0, 1.0, 2.0, 4.0, 8.0, 50.0])
    found = MODEL.misfit_of_other(d, through, off)
    assert found[0] == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_allclose(found[1], 0.5 * (1.0 / MODEL.outline_sd_mm) ** 2, rtol=0.01)
    assert (np.diff(found) > 0).all()
    np.testing.assert_allclose(found[-1], MODEL.unexplained(d), rtol=1e-9)
    np.testing.assert_allclose(MODEL.misfit_of_unread(d, off), MODEL.unread_weight * found, rtol=1e-6)


def test_distances_to_the_target() -> None:
    image = np.full((9, 9), -900.0, np.float32)
    image[4, 4] = 500.0
    found = outline_distances(image)
    assert found[4, 4] == 0.0
    assert found[4, 6] == pytest.approx(2.0)
    assert found[1, 1] == pytest.approx(3.0 * np.sqrt(2.0), rel=0.03)  # the transform is one of 5 x 5 masks
    assert outline_distances(-image).min() == pytest.approx(0.0)
    assert outline_distances(np.zeros((3, 3), np.float32)).min() > 1e3


def misfits_by_pixels(
    depth: np.ndarray, image: np.ndarray, model: PixelMixture, slope: float
) -> tuple[float, float]:
    """Sums over one tile, pixel by pixel."""
    distance = outline_distances(image)
    total = relief = 0.0
    for row, column in np.ndindex(depth.shape):
        d, y = float(depth[row, column]), float(image[row, column])
        if d > 0 and y <= 0:
            off = np.array(distance[row, column] * slope * d)
            of = model.misfit_of_other(np.array(d), np.array(-y), off) if y else None
            total += float(model.misfit_of_unread(np.array(d), off) if of is None else of)
        elif y > 0:
            beside = beside_by_pixels(depth, row, column, y, model, slope)
            here = (
                float(model.misfit(np.array(d), np.array(y))) if d else float(model.unexplained(np.array(y)))
            )
            if d:
                total += min(here, beside) if here > 2.0 else here
            else:
                relief += max(0.0, here - beside)
    return total, relief


def beside_by_pixels(
    depth: np.ndarray, row: int, column: int, y: float, model: PixelMixture, slope: float
) -> float:
    options = []
    for j, i in np.ndindex(5, 5):
        j, i = j - 2, i - 2
        inside = 0 <= row + j < depth.shape[0] and 0 <= column + i < depth.shape[1]
        if 0 < i * i + j * j <= 4 and inside and depth[row + j, column + i] > 0:
            d, off = float(depth[row + j, column + i]), np.hypot(i, j) * slope * y
            sd = float(model.noise_sd(np.array(y)))
            square = ((y - d) / sd) ** 2 + (off / model.outline_sd_mm) ** 2
            options.append((square, float(model.misfit(np.array(d), np.array(y), np.array(off)))))
    return min(options)[1] if options else np.inf


def test_sums_in_numpy_against_a_loop_over_pixels() -> None:
    rng = np.random.default_rng(3)
    depth = rng.choice([0.0, 500.0, 507.0, 540.0], (3, 8, 7)).astype(np.float32)
    depth += np.where(depth > 0, rng.normal(0.0, 0.5, depth.shape), 0.0).astype(np.float32)
    image = rng.choice([0.0, -900.0, -400.0, 503.0, 530.0], (8, 7)).astype(np.float32)
    misfit, relief = misfits_in_numpy(depth, image, MODEL, 0.004)
    for n in range(3):
        expected = misfits_by_pixels(depth[n], image, MODEL, 0.004)
        np.testing.assert_allclose((misfit[n], relief[n]), expected, rtol=1e-6)


def test_sums_on_the_device_are_those_in_numpy(device: RenderingDevice) -> None:
    kinect, anatomy = Camera(512, 424, 365.0, 365.0, 255.5, 211.5), make_anatomy()
    poses = scattered_poses(anatomy, 60, np.random.default_rng(2))
    window = Window.around(np.array([255.5, 211.5]), 48, 3)
    drawing = device.depth_renderer(hand_mesh(anatomy), (48, 48), 60)
    transforms = skinning_transforms(anatomy, poses)
    depth = drawing.depth(transforms, kinect, window)
    rng = np.random.default_rng(8)
    image = np.where(depth[3] > 0, depth[3] + rng.normal(0.0, 5.0, (48, 48)), -900.0).astype(np.float32)
    image[10:20] = np.where(image[10:20] > 0, -450.0, image[10:20])
    image[rng.random(image.shape) < 0.1] = 0.0
    for model in (MODEL, DBOT):
        found = drawing.sums(transforms, kinect, window, Comparison(image, 40.0, model))
        expected = sums_in_numpy(depth, Comparison(image, 40.0, model), window.step / kinect.fx)
        assert expected.relief.max() > 0
        assert expected.occluded.max() > 0
        np.testing.assert_allclose(found.misfit, expected.misfit, rtol=SUM_RELATIVE)
        np.testing.assert_allclose(found.relief, expected.relief, rtol=SUM_RELATIVE, atol=0.02)
        np.testing.assert_array_equal(found.occluded, expected.occluded)
    plain = drawing.sums(transforms, kinect, window, Comparison(image, 40.0))
    assert not plain.misfit.any()  # nobody asked
    assert not plain.relief.any()
    np.testing.assert_allclose(plain.error, found.error, rtol=1e-6)  # added up in another order
    np.testing.assert_array_equal(plain.both, found.both)


@pytest.mark.parametrize("error", [0.5, -1.0, 2.0, 100.0])
def test_a_plane_is_as_many_misfits_as_pixels(device: RenderingDevice, error: float) -> None:
    sheet, window = plane(600.0, 0.1, -0.2), Window.whole(CAMERA)
    drawing = device.depth_renderer(sheet, (CAMERA.width, CAMERA.height), 1)
    directions = rays(CAMERA, window)
    depth = 600.0 / (1.0 - 0.1 * directions[..., 0] + 0.2 * directions[..., 1])
    found = drawing.sums(
        STILL[None, None].astype(np.float32),
        CAMERA,
        window,
        Comparison((depth + error).astype("f4"), 40.0, MODEL),
    )
    rounded = moved_a_subpixel(depth)
    nearer, expected, farther = (
        MODEL.misfit(depth + off, depth + error).sum() for off in (-rounded, 0.0, rounded)
    )
    # of a slope of .2 the next pixels are some mm off in depth, so they explain nothing better
    assert found.misfit[0] == pytest.approx(expected, rel=1e-3, abs=np.ptp([nearer, expected, farther]))
