"""The tracks that a result may hold: what they are called, and where they lie."""

from __future__ import annotations

from posetrack_cli.errors import ResultError

FILTERED = "filtered"
"""Each estimate rests on the frames up to its own."""
SMOOTHED = "smoothed"
"""Each estimate rests on all frames of the recording."""
TRACKS = (FILTERED, SMOOTHED)

SMOOTHED_PREFIX = f"/{SMOOTHED}/"
TRANSFORMS_TOPIC = "/tf"
SMOOTHED_TRANSFORMS_TOPIC = f"{SMOOTHED_PREFIX}tf"


def topics_prefix(subject: str, track: str) -> str:
    """Return what the topics of a subject's track begin with: ``/hand``, ``/smoothed/hand``.

    Raises:
        ResultError: there is no such track.
    """
    if track not in TRACKS:
        raise ResultError("no such track", found=repr(track), expected=" or ".join(TRACKS))
    return f"/{subject}" if track == FILTERED else f"{SMOOTHED_PREFIX}{subject}"


def estimate_topic(subject: str, track: str = FILTERED) -> str:
    """Return the topic of a track's complete estimates."""
    return f"{topics_prefix(subject, track)}/estimate"


def body_frame(subject: str, track: str = FILTERED) -> str:
    """Return the frame id of a track's body: two bodies of one file must not share theirs."""
    return subject if track == FILTERED else f"{subject}_{track}"
