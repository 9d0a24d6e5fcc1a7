"""Depth sensors: camera, noise, edges and holes of readings, from published measurements.

Noise is sd(z) = a + b (z - c)^2. Sensors that match patterns or images also shift edges at random, extend
near surfaces by half their window (edge fattening), average within it, cast the shadow of projector or second
camera, and quantise disparity. Sensors that measure time of flight mix both surfaces at edges.

- Kinect v1: Khoshelham and Elberink, Sensors 12 (2012): 1/8 px of disparity; Nguyen, Izadi and Lovell,
  3DIMPVT 2012: axial sd 1.2 + 1.9 (z - 0.4)^2 mm, lateral sd 0.8 px.
- Azure Kinect: Toelgyessy, Dekan, Chovanec and Hubinsky, Sensors 21 (2021).
- D415, D435: quadratic, sd of disparity 0.08 px (Keselman et al., CVPRW 2017; Ahn et al., UR 2019).
- L515, SR305, iPhone: [ours], from data sheets; the LiDAR of phones interpolates few measured points.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from posetrack_cli.arrays import BoolArray, Float32Array, FloatArray, IntArray
from posetrack_cli.geometry.camera import Camera

KINECT_2 = "kinect2"  # simulated by ``frames``
JUMP_MM = 40.0
"""Minimum depth step of an edge."""


def _camera(width: int, height: int, focal_px: float) -> Camera:
    return Camera(width, height, focal_px, focal_px, (width - 1) / 2.0, (height - 1) / 2.0, name="camera")


@dataclass(frozen=True)
class Sensor:
    """A sensor.

    Attributes:
        camera: pinhole with a central principal point, so that a mirrored scene gives a mirrored image.
        noise_mm: a, b and c of the axial noise, z in metres.
        range_mm: measurement range.
        correlation_px: sd of the kernel that correlates noise; 0 for independent pixels.
        lateral_px: sd of the random shift of edges.
        fatten_px: largest extension of near surfaces.
        smear_px: sd of the average within a surface.
        mixed: share of readings at an edge that lie between both surfaces.
        eroded: share of missing readings on the nearer side of an edge.
        halo: shares of missing readings 1, 2, ... px beyond an edge.
        baseline_mm: of projector or second camera; 0 for none.
        subpixels: steps of disparity per px.
    """

    camera: Camera
    noise_mm: tuple[float, float, float]
    range_mm: tuple[float, float]
    correlation_px: float = 0.0
    lateral_px: float = 0.0
    fatten_px: float = 0.0
    smear_px: float = 0.0
    mixed: float = 0.0
    eroded: float = 0.0
    halo: tuple[float, ...] = ()
    baseline_mm: float = 0.0
    subpixels: float = 0.0

    def limited(self, *, noise: bool, edges: bool) -> Sensor:
        """Return the sensor without noise or without its effects at edges."""
        noise_mm = self.noise_mm if noise else (0.0, 0.0, 0.0)
        bare = Sensor(self.camera, noise_mm, self.range_mm, self.correlation_px)
        return replace(self, noise_mm=noise_mm) if edges else bare

    def readings(
        self, depth: Float32Array, rng: np.random.Generator, *, mirrored: bool = False
    ) -> Float32Array:
        """Return the readings (height, width), mm, of ideal depth; 0 where missing.

        Args:
            depth: mm, 0 where empty.
            rng: source of noise.
            mirrored: whether the shadow falls on the other side.
        """
        near = nearer_side(depth)
        hidden = self._shadow(depth, mirrored=mirrored) | self._missing(depth, near, rng)
        seen = self._smeared(self._shifted(self._fattened(depth, near, rng), rng))
        seen = self._mixed(seen, rng)
        noisy = seen + self._noise(seen, rng)
        read = self._quantised(noisy)
        low, high = self.range_mm
        read[hidden | (depth <= 0.0) | (read < low) | (read > high)] = 0.0
        return read

    def _noise(self, depth: Float32Array, rng: np.random.Generator) -> FloatArray:
        a, b, c = self.noise_mm
        sd = a + b * np.square(np.maximum(depth * 1e-3 - c, 0.0))
        return np.asarray(sd * smooth_field(depth.shape, self.correlation_px, rng), dtype=np.float64)

    def _fattened(self, depth: Float32Array, near: BoolArray, rng: np.random.Generator) -> Float32Array:
        """Extend near surfaces by half to all of ``fatten_px``, varying smoothly."""
        if not self.fatten_px or not near.any():
            return depth
        distance, source = _nearest(near)
        reach = self.fatten_px * (0.75 + 0.25 * np.tanh(smooth_field(depth.shape, self.fatten_px, rng)))
        source_depth = depth.ravel()[source]
        taken = (distance - 0.5 <= reach) & (depth - source_depth > JUMP_MM)  # the edge passes its centre
        return np.asarray(np.where(taken, source_depth, depth), dtype=np.float32)

    def _shifted(self, depth: Float32Array, rng: np.random.Generator) -> Float32Array:
        """Read each pixel from a place shifted at random; shifts of neighbours are similar."""
        if not self.lateral_px:
            return depth
        (height, width), (rows, columns) = depth.shape, np.indices(depth.shape)
        down, across = (np.rint(self.lateral_px * smooth_field(depth.shape, 1.0, rng)) for _ in range(2))
        rows = np.clip(rows + down, 0, height - 1).astype(np.int64)
        columns = np.clip(columns + across, 0, width - 1).astype(np.int64)
        return np.asarray(depth[rows, columns], dtype=np.float32)

    def _smeared(self, depth: Float32Array) -> Float32Array:
        if not self.smear_px:
            return depth
        import cv2

        return np.asarray(cv2.bilateralFilter(depth, -1, JUMP_MM / 2.0, self.smear_px), dtype=np.float32)

    def _mixed(self, depth: Float32Array, rng: np.random.Generator) -> Float32Array:
        """Place some readings at edges between both surfaces."""
        if not self.mixed:
            return depth
        import cv2

        share = rng.random(depth.shape, dtype=np.float32)
        behind = cv2.dilate(depth, np.ones((3, 3), np.uint8))
        chosen = nearer_side(depth) & (rng.random(depth.shape) < self.mixed)
        return np.where(chosen, depth + share * (behind - depth), depth)

    def _missing(self, depth: Float32Array, near: BoolArray, rng: np.random.Generator) -> BoolArray:
        """Draw missing readings at edges."""
        drawn = rng.random(depth.shape)
        missing: BoolArray = near & (drawn < self.eroded)
        if self.halo and near.any():
            distance, source = _nearest(near)
            places = np.arange(1, len(self.halo) + 2)
            share = np.interp(distance, places, (*self.halo, 0.0))
            beyond = (distance > 0.0) & (depth - depth.ravel()[source] > JUMP_MM)
            missing |= beyond & (drawn < share)
        return missing

    def _shadow(self, depth: Float32Array, *, mirrored: bool) -> BoolArray:
        """Return the pixels that the projector, or second camera, does not see: left of near surfaces.

        A pixel x appears there at x - f b / z; it is hidden by one to its right that appears left of it.
        """
        if not self.baseline_mm:
            return np.zeros(depth.shape, dtype=np.bool_)
        image = depth[:, ::-1] if mirrored else depth
        there = np.arange(image.shape[1]) - self._disparity(image)
        hidden: BoolArray = there > np.minimum.accumulate(there[:, ::-1], axis=1)[:, ::-1]
        return hidden[:, ::-1] if mirrored else hidden

    def _disparity(self, depth: FloatArray | Float32Array) -> FloatArray:
        return self.camera.fx * self.baseline_mm / np.maximum(depth, 1.0).astype(np.float64)

    def _quantised(self, depth: FloatArray) -> Float32Array:
        if not self.subpixels:
            return depth.astype(np.float32)
        steps = np.maximum(np.rint(self._disparity(depth) * self.subpixels), 1.0)
        return np.asarray(self.camera.fx * self.baseline_mm * self.subpixels / steps, dtype=np.float32)


_HALO = (0.6, 0.25)  # of time of flight
_STEREO_PX = 0.08  # sd of disparity


def _stereo(camera: Camera, baseline_mm: float) -> Sensor:
    """Return a RealSense stereo sensor: sd of depth = z^2 sd_d / (f b), windows of about 7 px."""
    per_m2 = 1e6 * _STEREO_PX / (camera.fx * baseline_mm)
    return Sensor(
        camera,
        (0.3, per_m2, 0.0),
        (200.0, 1e4),
        correlation_px=1.5,
        fatten_px=2.5,
        smear_px=1.5,
        eroded=0.05,
        baseline_mm=baseline_mm,
        subpixels=32.0,
    )


SENSORS = {
    "kinect1": Sensor(
        _camera(640, 480, 575.8),
        (1.2, 1.9, 0.4),
        (400.0, 4500.0),
        correlation_px=1.0,
        lateral_px=0.8,
        fatten_px=1.0,
        eroded=0.05,
        baseline_mm=75.0,
        subpixels=8.0,
    ),
    "azure-nfov": Sensor(
        _camera(640, 576, 504.0),
        (0.6, 0.3, 0.0),
        (500.0, 3860.0),
        mixed=0.15,
        eroded=0.1,
        halo=_HALO,
    ),
    "azure-wfov": Sensor(
        _camera(512, 512, 252.0),
        (0.9, 0.9, 0.0),
        (250.0, 2880.0),
        mixed=0.25,
        eroded=0.1,
        halo=_HALO,
    ),
    "d415": _stereo(_camera(848, 480, 606.0), 55.0),
    "d435": _stereo(_camera(848, 480, 424.2), 50.0),
    "l515": Sensor(
        _camera(640, 480, 457.0),
        (1.0, 0.5, 0.0),
        (250.0, 9000.0),
        mixed=0.3,
        eroded=0.05,
        halo=_HALO,
    ),
    "sr305": Sensor(
        _camera(640, 480, 475.0),
        (0.5, 2.0, 0.0),
        (200.0, 1500.0),
        lateral_px=0.4,
        smear_px=0.8,
        eroded=0.2,
        baseline_mm=26.0,
    ),
    "iphone-lidar": Sensor(
        _camera(256, 192, 213.0),
        (2.0, 1.5, 0.0),
        (200.0, 5000.0),
        correlation_px=2.0,
        fatten_px=1.0,
        smear_px=1.5,
        mixed=0.3,
    ),
}
"""Sensors other than a Kinect v2, by name."""


def smooth_field(shape: tuple[int, ...], sd_px: float, rng: np.random.Generator) -> Float32Array:
    """Return a Gaussian field of unit variance, smoothed with a kernel of this standard deviation."""
    noise = rng.standard_normal(shape, dtype=np.float32)
    if not sd_px:
        return noise
    import cv2

    size = 2 * round(3.0 * sd_px) + 1
    kernel = cv2.getGaussianKernel(size, sd_px)
    smooth = cv2.sepFilter2D(noise, cv2.CV_32F, kernel, kernel)
    unit: Float32Array = smooth / np.float32(np.sum(kernel**2))  # sd after both passes is sum k^2
    return unit


def _nearest(near: BoolArray) -> tuple[Float32Array, IntArray]:
    """Return each pixel's distance, px, from the nearest marked one, and that one's flat index."""
    import cv2

    distance, labels = cv2.distanceTransformWithLabels(
        (~near).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    index_of = np.zeros(int(labels.max()) + 1, dtype=np.int64)
    index_of[labels[near]] = np.flatnonzero(near)
    return distance.astype(np.float32), index_of[labels]


def nearer_side(depth: Float32Array) -> BoolArray:
    """Return the pixels (height, width) with a neighbour that is farther by at least a jump."""
    edge = np.zeros(depth.shape, dtype=np.bool_)
    across, down = np.diff(depth, axis=1), np.diff(depth, axis=0)
    edge[:, :-1] |= across > JUMP_MM
    edge[:, 1:] |= across < -JUMP_MM
    edge[:-1] |= down > JUMP_MM
    edge[1:] |= down < -JUMP_MM
    return edge & (depth > 0.0)
