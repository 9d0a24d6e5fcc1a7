"""The error of a truth that cannot be used."""

from __future__ import annotations

from posetrack_cli.errors import PosetrackError


class TruthError(PosetrackError):
    """A truth that cannot be read, or is of something else than the result."""
