"""Names of tracks and topics in result files."""

from __future__ import annotations

from posetrack_cli.errors import ResultError
from posetrack_cli.recording.topics import CALIBRATION, CAMERA_PREFIX

FILTERED = "filtered"
"""Each estimate uses only frames up to its own."""
SMOOTHED = "smoothed"
"""Each estimate uses all frames of the recording."""
TRACKS = (FILTERED, SMOOTHED)

SMOOTHED_PREFIX = f"/{SMOOTHED}/"
TRANSFORMS_TOPIC = "/tf"
SMOOTHED_TRANSFORMS_TOPIC = f"{SMOOTHED_PREFIX}tf"
CALIBRATION_TOPIC = f"{CAMERA_PREFIX}/{CALIBRATION}"
"""Topic of a single camera; with several cameras each has its own, ``/camera/<name>/calibration``."""


def topics_prefix(subject: str, track: str) -> str:
    """Return the topic prefix of a subject's track: ``/hand``, ``/hand/left``, ``/smoothed/hand``.

    Args:
        subject: ``Subject.topic``.
        track: one of ``TRACKS``.

    Raises:
        ResultError: unknown track.
    """
    if track not in TRACKS:
        raise ResultError("no such track", found=repr(track), expected=" or ".join(TRACKS))
    return f"/{subject}" if track == FILTERED else f"{SMOOTHED_PREFIX}{subject}"


def estimate_topic(subject: str, track: str = FILTERED) -> str:
    """Return the topic of a track's complete estimates."""
    return f"{topics_prefix(subject, track)}/estimate"


def body_frame(subject: str, track: str = FILTERED) -> str:
    """Return the frame id of a track's body, unique within a file."""
    return subject if track == FILTERED else f"{subject}_{track}"
