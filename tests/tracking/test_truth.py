"""Truth is carried over up to each stamp, once, in order."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, cast

from hypothesis import given
from hypothesis import strategies as st

from posetrack_cli.recording.base import TruthMessage
from posetrack_cli.tracking.run import truth_carrier


@dataclass
class Notes:
    """A writer that holds some truth already."""

    truth_messages: int = 0
    stamps: list[int] = field(default_factory=list)

    def add_truth(self, message: TruthMessage) -> None:
        self.stamps.append(message.log_time_ns)


def message(stamp_ns: int) -> TruthMessage:
    return TruthMessage("/truth/head/pose", "custom", "jsonschema", b"{}", "json", stamp_ns, b"{}")


@given(
    st.lists(st.integers(0, 50)).map(sorted),
    st.lists(st.integers(0, 60), min_size=1).map(sorted),
    st.integers(0, 10),
)
def test_what_is_due_is_written_and_no_more(stamps: list[int], frames: list[int], held: int) -> None:
    notes = Notes(held)
    carrier = truth_carrier(map(message, stamps), cast(Any, notes))
    for frame in frames:
        carrier.send(frame)
        assert notes.stamps == [stamp for stamp in stamps[held:] if stamp <= frame]
