"""Selection of rendering devices, the only module that knows their implementations; and their speed."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path

import numpy as np

from posetrack_cli.arrays import Float32Array
from posetrack_cli.errors import RenderingError
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.rendering.mesh import SkinnedMesh
from posetrack_cli.rendering.port import Comparison, RenderingDevice, Window


def open_device(index: int | None = None) -> RenderingDevice:
    """Open an OpenGL device without a display; the caller closes it.

    Args:
        index: index of an EGL device; None for the driver's default.

    Raises:
        RenderingError: the device is not usable.
    """
    from posetrack_cli.rendering.gl.device import GlDevice

    return GlDevice(index)


CPU = "cpu"
"""Name of the CPU device."""
_SOFTWARE = ("llvmpipe", "softpipe", "swrast", "SwiftShader")  # software OpenGL renderers
_GPUS = ("dri/renderD*", "nvidia[0-9]*", "dxg")  # below /dev


def open_fastest_device(choice: int | str | None = None) -> RenderingDevice:
    """Open the fastest device for many small depth images; the caller closes it.

    This is a GPU if there is one. Otherwise depth kernels compiled for the CPU are about three times as
    fast as software OpenGL and do not need OpenGL.

    Args:
        choice: index of an EGL device, or ``CPU``; None for the fastest.

    Raises:
        RenderingError: the chosen device is not usable.
    """
    return _opened(choice, is_fast=True)


def open_usual_device(choice: int | str | None = None) -> RenderingDevice:
    """Open the driver's default device, or the CPU if there is no OpenGL; the caller closes it.

    Args:
        choice: index of an EGL device, or ``CPU``; None for the default.

    Raises:
        RenderingError: the chosen device is not usable.
    """
    return _opened(choice, is_fast=False)


def _opened(choice: int | str | None, *, is_fast: bool) -> RenderingDevice:
    """Open the chosen device, or else the default (with ``is_fast``: if it is a GPU), or else the CPU."""
    from posetrack_cli.rendering.cpu import CpuDevice

    if isinstance(choice, int):
        return open_device(choice)
    if choice is None and (_has_gpu() or not is_fast):
        with suppress(RenderingError):
            device = open_device()
            if not (is_fast and any(name in device.info.renderer for name in _SOFTWARE)):
                return device
            device.close()
    return CpuDevice()


def _has_gpu() -> bool:
    """Return whether a GPU may be present; a quick check, as opening OpenGL is slow."""
    return any(any(Path("/dev").glob(pattern)) for pattern in _GPUS)


@contextmanager
def device_or_default(device: RenderingDevice | None) -> Iterator[RenderingDevice]:
    """Yield the device, or the usual one if None, which is closed at the end."""
    if device is not None:
        yield device
        return
    with closing(open_usual_device()) as opened:
        yield opened


KINECT2 = Camera(512, 424, 365.0, 365.0, 255.5, 211.5, name="kinect2")


WARM_UP = 2
"""Unmeasured repetitions before a measurement."""


def median_milliseconds(
    work: Callable[[], object], repeats: int, advance: Callable[[int], object] = lambda count: None
) -> float:
    """Return the median wall-clock time of ``work``, ms; ``advance`` is called after each repetition."""
    times = []
    for k in range(WARM_UP + repeats):
        began = time.perf_counter()
        work()
        advance(1)
        if k >= WARM_UP:
            times.append(time.perf_counter() - began)
    return 1e3 * float(np.median(times))


def scoring_milliseconds(
    device: RenderingDevice,
    mesh: SkinnedMesh,
    transforms: Float32Array,
    tile: int,
    step: int,
    repeats: int,
    advance: Callable[[int], object] = lambda count: None,
) -> float:
    """Return the median time to render and score all poses (N, B, 3, 4) in a Kinect v2 window, ms."""
    renderer = device.depth_renderer(mesh, (tile, tile), len(transforms))
    window = Window.around(np.array([KINECT2.cx, KINECT2.cy]), tile, step)
    observed = renderer.depth(transforms[:1], KINECT2, window)[0]
    return median_milliseconds(
        lambda: renderer.sums(transforms, KINECT2, window, Comparison(observed, 40.0)), repeats, advance
    )
