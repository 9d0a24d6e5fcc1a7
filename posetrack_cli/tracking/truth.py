"""Truth that a recording carries goes over into the result."""

from __future__ import annotations

from collections.abc import Generator, Iterator
from itertools import islice

from posetrack_cli.recording.base import TruthMessage
from posetrack_cli.results.writer import ResultWriter


def truth_carrier(messages: Iterator[TruthMessage], writer: ResultWriter) -> Generator[None, int]:
    """Return a coroutine that carries truth over up to each stamp (ns) it is sent.

    What a resumed result holds already is left out.
    """
    carrier = _carry(messages, writer)
    next(carrier)
    return carrier


def _carry(messages: Iterator[TruthMessage], writer: ResultWriter) -> Generator[None, int]:
    messages = islice(messages, writer.truth_messages, None)
    message, stamp = next(messages, None), (yield)
    while True:
        while message is not None and message.log_time_ns <= stamp:
            writer.add_truth(message)
            message = next(messages, None)
        stamp = yield
