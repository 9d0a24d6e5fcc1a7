"""Which device draws: the one place that knows an implementation of the port."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing, contextmanager

from posetrack_cli.rendering.port import RenderingDevice


def open_device(index: int | None = None) -> RenderingDevice:
    """Return a device that draws without a display; the caller closes it.

    Args:
        index: of an EGL device, None for the driver's default.

    Raises:
        RenderingError: nothing can be drawn with it here.
    """
    from posetrack_cli.rendering.gl.device import GlDevice

    return GlDevice(index)


@contextmanager
def device_or_default(device: RenderingDevice | None) -> Iterator[RenderingDevice]:
    """Yield the device, or without one the default, which is closed at the end."""
    if device is not None:
        yield device
        return
    with closing(open_device()) as opened:
        yield opened
