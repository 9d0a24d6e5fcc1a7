"""What a head run expects of a head tracker."""

from __future__ import annotations

from typing import Any, Protocol, TypeVar

import numpy as np

from posetrack_cli.errors import RecordingError
from posetrack_cli.recording.base import Frame
from posetrack_cli.tracking.protocol import Tracker

State = TypeVar("State")


class NoFaceError(RecordingError):
    """A face was found in no frame of a recording."""


class HeadTracker(Tracker[State], Protocol[State]):
    """A head tracker: finds the head by itself, and learns its face while it tracks.

    ``Estimate.shape`` holds the B deformation coefficients a, ``Estimate.points`` the recalculated points M'
    in camera axes, ``Estimate.numbers`` what ``head.subject.number_names`` lists. All are finite also in
    frames before the head is found, whose status is lost.
    """

    def start(self, frame: Frame, rng: np.random.Generator) -> State:
        """Return the state before a first frame, in which the head has yet to be found."""

    def learned(self, state: State) -> dict[str, np.ndarray[Any, Any]]:
        """Return what was learned of the face, shape model and templates, as arrays by name.

        Another tracker can begin with it: in a second pass, or of another recording of the same person.
        Empty before the head is found.
        """

    def not_found(self, state: State) -> str:
        """Say how a head was looked for that was found in no frame yet; empty once it was found.

        Such as ``600 frames searched, best score 0.31``: it completes "no face found".
        """

    def remarks(self, state: State) -> tuple[str, ...]:
        """Say what a user should know about a finished run beside its numbers; each is one line."""
