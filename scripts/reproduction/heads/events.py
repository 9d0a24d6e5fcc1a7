"""When what happens in a synthetic recording of a head."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from mcap.records import Metadata

from posetrack_cli.mcap.stream import McapFile
from posetrack_cli.synthesis.recording import SYNTH_RECORD

Interval = tuple[float, float]


@dataclass(frozen=True)
class Events:
    """From when until when, s since the first frame; None for what does not happen.

    Attributes:
        turn: two sudden turns of the head.
        occlusion: an object before the face.
    """

    turn: Interval | None = None
    occlusion: Interval | None = None

    @property
    def end_s(self) -> float | None:
        """When a tracker that lost the head may be expected to find it again."""
        ends = [interval[1] for interval in (self.turn, self.occlusion) if interval is not None]
        return max(ends, default=None)


NOTHING = Events()


def events_of(recording: Path) -> Events:
    """Return what the record of a synthetic recording, an MCAP file, tells; of any other nothing."""
    if not recording.is_file():
        return NOTHING
    for record in McapFile(recording).extras():
        if isinstance(record, Metadata) and record.name == SYNTH_RECORD:
            told = record.metadata
            return Events(_interval(told.get("turn_s", "")), _interval(told.get("occlusion_s", "")))
    return NOTHING


def _interval(text: str) -> Interval | None:
    """Two numbers; None for no text."""
    if not text:
        return None
    start, end = map(float, text.split())
    return start, end
