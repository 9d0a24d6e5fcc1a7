"""Building blocks of recording descriptions: cameras, stamps and losses as plain values."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from itertools import zip_longest
from typing import Any

import numpy as np

from posetrack_cli.errors import PosetrackError
from posetrack_cli.losses import Loss
from posetrack_cli.recording.recording import Recording
from posetrack_cli.recording.timeline import Timeline


def try_open(open_: Callable[[], Recording]) -> tuple[Recording | None, str | None]:
    """Return a recording, or the reason why it cannot be opened."""
    try:
        return open_(), None
    except PosetrackError as error:
        return None, str(error)


def described_cameras(recording: Recording | None) -> list[dict[str, Any]]:
    """Return a recording's cameras as plain values, with baseline to the reference, mm, and source."""
    if recording is None:
        return []
    return [
        camera.values()
        | {"distance_mm": float(np.linalg.norm(np.array(camera.camera_T_reference)[:, 3])), "why": why}
        for camera, why in zip_longest(recording.cameras, recording.why, fillvalue="")
        if not isinstance(camera, str)
    ]


def described_use(open_: Callable[[], Recording], command: str) -> dict[str, Any]:
    """Return the cameras that a command would use and their source, or why it cannot run."""
    recording, problem = try_open(open_)
    return {
        "command": command,
        "cameras": described_cameras(recording),
        "remarks": [] if recording is None else list(recording.remarks),
        "problem": problem,
    }


def described_stamps(stamps: Iterable[int]) -> dict[str, Any]:
    """Return rate, gaps and order of stamps, ns, with remarks on implausible values."""
    timeline = Timeline()
    for stamp in stamps:
        timeline.add(stamp)
    return timeline.summary() | {"remarks": list(timeline.remarks)}


def described_losses(losses: tuple[Loss, ...]) -> list[dict[str, Any]]:
    """Return losses as plain values."""
    return [{"what": loss.what, "count": loss.count, "first": loss.first} for loss in losses]
