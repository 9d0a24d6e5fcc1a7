"""What a result states about its run: all that its bytes depend on but the machine, nothing else."""

from __future__ import annotations

import json

from posetrack_cli import __version__
from posetrack_cli.configuration import Settings
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.recording.recording import Recording
from posetrack_cli.tracking.options import RunOptions


def common_record(
    tracker: str, recording: Recording, camera: Camera, config: Settings, options: RunOptions
) -> dict[str, str]:
    """Return what the records of all trackers' runs state.

    Args:
        tracker: its name.
        recording: its identity is stated, not its path.
        camera: that estimates are relative to, with the intrinsics that are used.
        config: resolved, with the defaults.
        options: frames and seed.
    """
    return {
        "tracker": tracker,
        "version": __version__,
        "configuration": json.dumps(config.model_dump(mode="json")),
        "seed": str(options.seed),
        "start": str(options.start),
        "end": "" if options.end is None else str(options.end),
        "stride": str(options.stride),
        "timings": str(options.timings).lower(),
        "camera": json.dumps(camera.values()),
        **{f"input.{key}": value for key, value in recording.identity().items()},
    }
