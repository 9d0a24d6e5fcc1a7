"""Which device draws: the one place that knows implementations of the port; and how fast one scores."""

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
    """Return a device that draws without a display; the caller closes it.

    Args:
        index: of an EGL device, None for the driver's default.

    Raises:
        RenderingError: nothing can be drawn with it here.
    """
    from posetrack_cli.rendering.gl.device import GlDevice

    return GlDevice(index)


CPU = "cpu"
"""Names the processor as a device."""
_SOFTWARE = ("llvmpipe", "softpipe", "swrast", "SwiftShader")  # what draws OpenGL without a GPU
_GPUS = ("dri/renderD*", "nvidia[0-9]*", "dxg")  # below /dev


def open_fastest_device(choice: int | str | None = None) -> RenderingDevice:
    """Return the device that draws many small depth images fastest; the caller closes it.

    That is a GPU, if there is one. Where OpenGL is drawn by the processor, kernels compiled for depth alone
    are some three times as fast, and need no OpenGL.

    Args:
        choice: index of an EGL device, or ``CPU``; None for the fastest.

    Raises:
        RenderingError: nothing can be drawn with what is chosen.
    """
    return _opened(choice, is_fast=True)


def open_usual_device(choice: int | str | None = None) -> RenderingDevice:
    """Return the driver's default device, or the processor where there is no OpenGL; the caller closes it.

    Args:
        choice: index of an EGL device, or ``CPU``; None for the default.

    Raises:
        RenderingError: nothing can be drawn with what is chosen.
    """
    return _opened(choice, is_fast=False)


def _opened(choice: int | str | None, *, is_fast: bool) -> RenderingDevice:
    """The chosen device; else the default, if it works (and is a GPU, if it must be fast); else the CPU."""
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
    """Whether this may be a machine with a GPU; OpenGL takes long to say so."""
    return any(any(Path("/dev").glob(pattern)) for pattern in _GPUS)


@contextmanager
def device_or_default(device: RenderingDevice | None) -> Iterator[RenderingDevice]:
    """Yield the device, or without one the usual, which is closed at the end."""
    if device is not None:
        yield device
        return
    with closing(open_usual_device()) as opened:
        yield opened


KINECT2 = Camera(512, 424, 365.0, 365.0, 255.5, 211.5, name="kinect2")


WARM_UP = 2
"""Times that some work is done before it is measured."""


def median_milliseconds(
    work: Callable[[], object], repeats: int, advance: Callable[[int], object] = lambda count: None
) -> float:
    """The median wall-clock time of some work, ms; ``advance`` counts how often it is done."""
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
    """Median time to draw and reduce all poses (N, B, 3, 4) in a Kinect v2's window, ms."""
    renderer = device.depth_renderer(mesh, (tile, tile), len(transforms))
    window = Window.around(np.array([KINECT2.cx, KINECT2.cy]), tile, step)
    observed = renderer.depth(transforms[:1], KINECT2, window)[0]
    return median_milliseconds(
        lambda: renderer.sums(transforms, KINECT2, window, Comparison(observed, 40.0)), repeats, advance
    )
