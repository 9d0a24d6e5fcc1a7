"""Simulated sensors on a plane and a step: published noise, steps and shadows; edges that move as stated."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from posetrack_cli.arrays import Float32Array
from posetrack_cli.recording.camera_file import load_depth_camera
from posetrack_cli.synthesis.hand.frames import synthesise
from posetrack_cli.synthesis.hand.options import SynthOptions
from posetrack_cli.synthesis.hand.sensors import SENSORS, Sensor

NEAR_MM, FAR_MM = 650.0, 2000.0
CAMERAS = Path(__file__).parents[3] / "configs" / "cameras"


def plane(sensor: Sensor, depth_mm: float) -> Float32Array:
    return np.full((sensor.camera.height, sensor.camera.width), depth_mm, dtype=np.float32)


def step(sensor: Sensor) -> Float32Array:
    """A near surface in the middle third of the columns."""
    image, third = plane(sensor, FAR_MM), sensor.camera.width // 3
    image[:, third : 2 * third] = NEAR_MM
    return image


def only(name: str, *kept: str) -> Sensor:
    """A sensor with some of its effects."""
    bare = SENSORS[name].limited(noise=False, edges=False)
    return replace(bare, **{field: getattr(SENSORS[name], field) for field in kept})


@pytest.mark.parametrize(
    ("name", "depth_mm", "sd_mm"),
    [
        ("kinect1", 3000.0, 1.2 + 1.9 * 2.6**2),  # Nguyen et al.: 14.0 mm
        ("azure-nfov", 1000.0, 0.9),
        ("d435", 1000.0, 0.3 + 1e3**2 * 0.08 / (424.2 * 50.0)),  # 4.1 mm
        ("d435", 500.0, 0.3 + 5e2**2 * 0.08 / (424.2 * 50.0)),
    ],
)
def test_noise_of_a_plane(name: str, depth_mm: float, sd_mm: float) -> None:
    """Of 3e5 pixels the sd is exact to .2 %, with correlated ones to some 2 %."""
    noisy = SENSORS[name].limited(noise=True, edges=False)
    image = noisy.readings(plane(noisy, depth_mm), np.random.default_rng(1))
    assert image.mean() == pytest.approx(depth_mm, abs=0.1 * sd_mm)
    assert image.std() == pytest.approx(sd_mm, rel=0.03)


def test_a_sensor_without_noise_and_edges_is_ideal() -> None:
    for sensor in SENSORS.values():
        bare, image = sensor.limited(noise=False, edges=False), step(sensor)
        in_range = np.where(image <= sensor.range_mm[1], image, 0.0)
        np.testing.assert_array_equal(bare.readings(image, np.random.default_rng(1)), in_range)


def test_depth_steps_of_a_kinect_are_those_of_the_paper() -> None:
    """Khoshelham and Elberink: 7 cm at 5 m, 2.85e-3 z^2 metres."""
    sensor = replace(only("kinect1", "baseline_mm", "subpixels"), range_mm=(0.0, 1e4))
    ramp = plane(sensor, 5000.0) + np.linspace(-150.0, 150.0, sensor.camera.width, dtype=np.float32)
    levels = np.unique(sensor.readings(ramp, np.random.default_rng(1))[0])
    assert np.diff(levels).mean() == pytest.approx(71.0, rel=0.03)


@pytest.mark.parametrize("name", ["kinect1", "d415", "d435"])
@pytest.mark.parametrize("mirrored", [False, True])
def test_the_shadow_of_a_near_surface(name: str, mirrored: bool) -> None:
    """f b (1 / near - 1 / far) pixels, to a pixel, at one side."""
    sensor = only(name, "baseline_mm")
    missing = sensor.readings(step(sensor), np.random.default_rng(1), mirrored=mirrored)[0] == 0.0
    width = sensor.camera.fx * sensor.baseline_mm * (1.0 / NEAR_MM - 1.0 / FAR_MM)
    third = sensor.camera.width // 3
    sides = missing[:third].sum(), missing[2 * third :].sum()
    assert sides[mirrored] == pytest.approx(width, abs=1.0) and sides[not mirrored] == 0
    assert not missing[third : 2 * third].any()


@pytest.mark.parametrize("name", ["kinect1", "d435", "iphone-lidar"])
def test_near_surfaces_grow_by_half_the_window(name: str) -> None:
    """On average by three quarters of the largest extension, in whole pixels."""
    sensor = only(name, "fatten_px")
    image = step(sensor)
    grown = (sensor.readings(image, np.random.default_rng(1)) == NEAR_MM).sum(axis=1) - (
        image[0] == NEAR_MM
    ).sum()
    per_side = grown / 2.0
    assert per_side.min() >= 0.0 and per_side.max() <= sensor.fatten_px + 0.5
    assert per_side.mean() == pytest.approx(0.75 * sensor.fatten_px, abs=0.5)


@pytest.mark.parametrize("name", ["azure-nfov", "azure-wfov", "l515"])
def test_a_share_of_the_edge_lies_between_both_surfaces(name: str) -> None:
    sensor = only(name, "mixed")
    image = step(sensor)
    read = sensor.readings(image, np.random.default_rng(1))
    edge = np.flatnonzero(np.diff(image[0]) > 0)[0]
    column = read[:, edge]
    between = (column > NEAR_MM) & (column < FAR_MM)
    assert between.mean() == pytest.approx(sensor.mixed, abs=3.0 * np.sqrt(0.25 / len(column)))
    np.testing.assert_array_equal(
        np.delete(read, [edge, len(image[0]) // 3], axis=1),
        np.delete(image, [edge, len(image[0]) // 3], axis=1),
    )


@pytest.mark.parametrize(
    ("name", "file"),
    [("kinect1", "kinect1"), ("d435", "d435-848"), ("iphone-lidar", "iphone-lidar"), ("sr305", "sr300")],
)
def test_cameras_are_the_shipped_ones(name: str, file: str) -> None:
    camera, shipped = SENSORS[name].camera, load_depth_camera(CAMERAS / f"{file}.toml")
    assert (camera.width, camera.height) == (shipped.width, shipped.height)
    assert camera.fx == pytest.approx(shipped.fx, abs=0.1) and camera.cx == shipped.cx


def test_a_synthetic_recording_of_a_sensor_has_its_size() -> None:
    options = SynthOptions(frames=1, sensor="iphone-lidar")
    (frame,) = synthesise(options)
    assert frame.depth.shape == (192, 256) and (frame.depth > 0).mean() > 0.9
