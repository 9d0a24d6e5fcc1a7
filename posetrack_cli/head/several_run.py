"""Runs that track all heads in the images: one result with a track per person."""

from __future__ import annotations

import colorsys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from typing import Any

from posetrack_cli.errors import ResultError
from posetrack_cli.head.run import HeadRun
from posetrack_cli.head.smoothing.frames import HeadMemory
from posetrack_cli.head.tracker.several import HeadsState, HeadsTracker
from posetrack_cli.outputs import state_path
from posetrack_cli.results import spool
from posetrack_cli.results.estimate import Estimate, Subject
from posetrack_cli.results.writer import ResultWriter
from posetrack_cli.tracking.loop import RunState
from posetrack_cli.tracking.run import FrameMemory
from posetrack_cli.tracking.smoothing import smoothing_path
from posetrack_cli.tracking.two_pass import Learned, learned_before


class HeadsRun(HeadRun):
    """Run of ``HeadsTracker`` over a recording, with two passes; see ``HeadRun``.

    The first pass finds the people. With a single one, the result is that of a run with one head.
    """

    tracker: HeadsTracker

    @contextmanager
    def open_memory(self, writer: ResultWriter) -> Iterator[FrameMemory | None]:
        """Open the stores of frames for smoothing, one per head; None without smoothing."""
        if not self._options.smooth:
            yield None
            return
        path = smoothing_path(self._options.output)
        with ExitStack() as opened:
            yield _Memories(
                [
                    opened.enter_context(
                        HeadMemory(
                            path.with_name(f"{path.name}{number}"),
                            self._config,
                            subject,
                            len(self.cameras),
                            self._origin,
                            writer.frames_written,
                            number,
                        )
                    )
                    for number, subject in enumerate(self.subjects)
                ]
            )

    def finish(self, writer: ResultWriter, state: Any) -> dict[str, str]:
        """Return entries of the summary; models of several people are not attached."""
        return {"passes": str(self._config.run.passes)}

    def _open(self) -> tuple[ResultWriter, RunState]:
        """Open the result; one that is resumed in its second pass has the subjects of the first."""
        if self._options.resume:
            # an unusable checkpoint is reported by the writer, which checks more
            with suppress(ResultError):
                learned = learned_before(spool.load(state_path(self._options.output))[0])
                if learned:
                    self._begin_second_pass(learned)
        return super()._open()

    def _begin_second_pass(self, learned: Learned) -> None:
        super()._begin_second_pass(learned)
        self.subjects = labelled(self.subjects[0], self.tracker.count)


def labelled(subject: Subject, count: int) -> tuple[Subject, ...]:
    """Return subjects labelled 1, 2, ... with different colours; an only one has no label."""
    if count == 1:
        return (subject,)
    colours = [colorsys.hsv_to_rgb((0.52 + k / count) % 1.0, 0.7, 0.95) for k in range(count)]
    return tuple(
        replace(subject, label=str(k + 1), colour=(*colour, 1.0)) for k, colour in enumerate(colours)
    )


class _Memories:
    """Frames of all heads (``tracking.run.FrameMemory``)."""

    def __init__(self, memories: Sequence[HeadMemory]) -> None:
        self._memories = memories

    def remember(self, state: HeadsState, *estimates: Estimate) -> None:
        for memory, member, estimate in zip(self._memories, state.members, estimates, strict=True):
            memory.remember(member.state, estimate)

    def flush(self) -> None:
        for memory in self._memories:
            memory.flush()

    def finish(self, writer: ResultWriter) -> None:
        for memory in self._memories:
            memory.finish(writer)
