"""posetrack: batch tracking of hands and heads in recorded depth and video.

``import posetrack_cli as posetrack`` gives ``read``, ``open_recording``, ``track_hand``, ``track_head``,
``evaluate`` and ``Camera`` (see ``posetrack_cli.api``). They are loaded on first use.
"""

from __future__ import annotations

import os
from importlib import import_module
from typing import TYPE_CHECKING, Any

from posetrack_cli.limits import IMAGE_PIXELS

if TYPE_CHECKING:
    from posetrack_cli.api import evaluate, open_recording, read, track_hand, track_head
    from posetrack_cli.errors import PosetrackError
    from posetrack_cli.geometry.camera import Camera

__all__ = ["Camera", "PosetrackError", "evaluate", "open_recording", "read", "track_hand", "track_head"]

_HOMES = {"Camera": "geometry.camera", "PosetrackError": "errors"}

# Must be set before cv2 is imported; OpenCV's own default is 32 times higher.
os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(IMAGE_PIXELS))


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES.get(name, 'api')}"), name)
