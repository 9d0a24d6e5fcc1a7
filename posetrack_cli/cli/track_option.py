"""The option that chooses between a result's tracks."""

from __future__ import annotations

FILTERED, SMOOTHED = "filtered", "smoothed"
TRACKS = (FILTERED, SMOOTHED)
"""As ``results.tracks`` has them, which would take long to load for the help."""
BOTH = "both"


def chosen_tracks(track: str | None) -> tuple[str, ...]:
    """Return the tracks that an option's value names, the filtered one for none."""
    return TRACKS if track == BOTH else (track or FILTERED,)
