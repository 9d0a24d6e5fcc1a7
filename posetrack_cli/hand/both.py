"""Whether a recording shows both hands of a person, and the shape that these share."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import islice
from typing import NamedTuple

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.errors import RecordingError
from posetrack_cli.hand.config import SIDES, HandConfig
from posetrack_cli.hand.fit.gauss_newton import STIFF_THUMB
from posetrack_cli.hand.model.hand import hand_maker
from posetrack_cli.hand.search import (
    ACCEPT_MM,
    LIKELY_PAIR_MM,
    Acquisition,
    Candidate,
    cheapest_pair,
    detection_penalty,
    least_cost_at,
    quick_search,
)
from posetrack_cli.hand.shape_fit import Calibration, CalibrationOptions, combined, shape_of
from posetrack_cli.phases import phase
from posetrack_cli.recording.base import Frame
from posetrack_cli.recording.recording import Recording

FRAMES, _FEW = 16, 6
"""Frames of the whole recording that are searched for two hands, and least number that show both."""
SECOND_MM = 12.0
"""Largest cautious cost of the costlier of two hands **[ours]**.

Open hands that the average hand does not fit cost up to 10 mm. In recordings of one hand, upper arms, bodies
and backgrounds cost at least 14 mm as a second one. An elbow may look like a hand, but lies on the same arm
(``search.cheapest_pair``).
"""
_LEAST_COST_MM = 2.5
"""Cost of the best fits of an average hand of the right size."""

_MOST_LEAD_MM, _CLEAR_LEAD_MM = 2.7, 3.6
"""Largest evidence of a frame for a side, and least evidence of all: 3 and 4 log odds (``autodetect``)."""


class PairFrame(NamedTuple):
    """A frame with two hands.

    Attributes:
        frame: the frame.
        wrists: (3,) of the right and of the left hand, mm; None for one that was not found.
        leads: by how much either hand costs less than one of the other side at its place, mm.
    """

    frame: Frame
    wrists: tuple[FloatArray | None, FloatArray | None]
    leads: tuple[float, float]

    @property
    def shows_both(self) -> bool:
        """Return whether both hands were found."""
        return all(wrist is not None for wrist in self.wrists)

    def only(self, side: str) -> PairFrame:
        """Return the frame with the hand of one side alone."""
        right, left = self.wrists
        return self._replace(wrists=(right, None) if side == SIDES[0] else (None, left))


class PairFinder:
    """Finds frames with a right and a left hand, over the whole recording.

    Args:
        recording: depth frames.
        config: of hand and search.
        scale: of the hands.
        start: first frame.
    """

    def __init__(self, recording: Recording, config: HandConfig, scale: float, start: int) -> None:
        self._finders = [_finder(config, side, scale, recording) for side in SIDES]
        count = recording.frame_count
        stride = FRAMES if count is None else max(1, (count - start) // FRAMES)
        self._recording, self._start, self._stride = recording, start, stride

    @property
    def shows_two(self) -> bool:
        """Whether two frames, or the only one, clearly show two hands: a body may look like one once."""
        pairs = self._pairs("looking for a second hand", SECOND_MM)
        least = 1 if self._recording.frame_count == self._start + 1 else 2
        return len(list(islice((one for one in pairs if one.shows_both), least))) == least

    @property
    def frames(self) -> list[PairFrame]:
        """The frames that probably show both of two hands; if they are few, also those that show one."""
        found = list(self._pairs("finding both hands", LIKELY_PAIR_MM))
        both = [one for one in found if one.shows_both]
        return both if len(both) >= _FEW else found

    def _pairs(self, name: str, limit_mm: float) -> Iterator[PairFrame]:
        frames = self._recording.frames(start=self._start, end=None, stride=self._stride)
        with phase(name, "frame", FRAMES) as advance:
            for frame in islice(frames, FRAMES):
                pair = self._pair_in(frame, limit_mm)
                if pair is not None:
                    yield pair
                advance(1)

    def _pair_in(self, frame: Frame, limit_mm: float) -> PairFrame | None:
        """Return a frame's hands, each with a cost below a limit; None if it cannot show two."""
        likely = [
            (penalty, detection)
            for detection in self._finders[0].detect(frame.depth, is_sized=True)
            if 2.0 * (penalty := detection_penalty(detection)) < limit_mm - _LEAST_COST_MM
        ]
        found: list[list[Candidate]] = [[], []]
        places = len(likely)
        # the least likely first: without a second hand, the fits of the first one are not needed
        for _, detection in sorted(likely, key=lambda one: -one[0]):
            if places < len(SIDES):
                return None
            fits = [finder.candidates_at(frame.depth, [detection]) for finder in self._finders]
            places -= not any(one.cautious_cost < limit_mm for these in fits for one in these)
            found = [known + more for known, more in zip(found, fits, strict=True)]
        pair = cheapest_pair(*found)
        first, second = (_lead_mm(one, others) for one, others in zip(pair, reversed(found), strict=True))
        right, left = (None if one is None or one.cautious_cost >= limit_mm else one.pose[:3] for one in pair)
        return PairFrame(frame, (right, left), (first, second))


def _lead_mm(found: Candidate | None, others: Sequence[Candidate]) -> float:
    """Return by how much a hand costs less than the other side at its place; 0 if either was not found."""
    other_mm = ACCEPT_MM if found is None else least_cost_at(found, others)
    return 0.0 if found is None or other_mm == ACCEPT_MM else other_mm - found.total_cost


def common_side(found: Sequence[PairFrame]) -> str | None:
    """Return the side of which both hands are, as those of two people; None for a right and a left hand."""
    both = [np.clip(one.leads, -_MOST_LEAD_MM, _MOST_LEAD_MM) for one in found if one.shows_both]
    leads = np.sum(both, axis=0) if both else np.zeros(len(SIDES))
    return SIDES[1 - int(np.argmin(leads))] if leads.min() < -_CLEAR_LEAD_MM else None


def _finder(config: HandConfig, side: str, scale: float, recording: Recording) -> Acquisition:
    hand = hand_maker(config.hand.mesh)(side, replace(config.hand.shape, scale=scale))
    return Acquisition(quick_search(config), hand, recording.cameras[0], STIFF_THUMB)


def shape_of_both(
    recording: Recording,
    config: HandConfig,
    found: Sequence[PairFrame],
    is_usable: Callable[[Calibration], bool],
) -> Calibration | None:
    """Estimate the shape that two hands share; None if neither hand has a usable one.

    Args:
        recording: depth frames.
        config: with the size of the hands.
        found: frames that show both.
        is_usable: whether to use the shape of one hand.
    """
    shapes = []
    for side, name in enumerate(SIDES):
        hand = config.hand.model_copy(update={"side": name})
        places = [(one.frame, wrist) for one in found if (wrist := one.wrists[side]) is not None]
        options = CalibrationOptions(side=name, places=places)
        try:
            one = shape_of(recording, config.model_copy(update={"hand": hand}), options)
        except RecordingError:  # too few frames
            continue
        shapes += [one] if is_usable(one) else []
    if len(shapes) == len(SIDES):
        return combined(shapes[0], shapes[1], config.hand.mesh)
    return shapes[0] if shapes else None
