"""A smoothed track: what a smoother keeps of each frame, spooled, and smoothed backwards."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, Generic, NamedTuple, Self, TypeAlias, TypeVar

import numpy as np

from posetrack_cli.errors import ResultError
from posetrack_cli.filtering.smoothing import NOTHING, Memory, Smoothed, Smoother, Step
from posetrack_cli.results.columns import (
    STAMPS_NS,
    Layout,
    LayoutError,
    check_arrays,
    counts,
    floats,
)
from posetrack_cli.results.estimate import Estimate, Status
from posetrack_cli.results.spool import RESTART_HINT, Array, RecordSpool

Described = TypeVar("Described")
STATUSES = tuple(Status)
KEPT, BESIDES = "filter.", "frame."
"""What names of a record begin with that are the smoother's, and that are kept for ``describe`` besides."""
_NO_FRAME = {"frame_index": 0, "stamp_ns": 0, "status": 0, "cut": 0, "dt": 0.0, "confidence": 0.0}


class FrameFacts(NamedTuple):
    """What an estimate says of its frame, smoothed or not: fields of ``Estimate``."""

    frame_index: int
    stamp_ns: int
    status: Status
    confidence: float

    @classmethod
    def of(cls, estimate: Estimate) -> FrameFacts:
        """Return those of an estimate."""
        return cls(*(getattr(estimate, name) for name in cls._fields))


Describe: TypeAlias = Callable[[Smoothed, FrameFacts, Memory], Described]
"""Makes what is written of a smoothed state, of its frame, and of what was kept of it."""


class Kept(NamedTuple):
    """What a file of an interrupted run is to hold.

    Attributes:
        frames: how many of them stay; 1 or more.
        state: any that the smoother remembers, and
        frame: what is kept of any frame: those that stay have to be of the same arrays.
    """

    frames: int
    state: Any
    frame: Memory = NOTHING


class SmoothedTrack(Generic[Described]):
    """Remembers every frame of a run and then smooths them, from the last to the first.

        with SmoothedTrack(path, smoother, describe, kept) as track:
            track.remember(state.particles, FrameFacts.of(estimate), dt, cut, frame)  # each frame
            track.flush()                                           # before a checkpoint
            for estimate in track.backward(): ...                   # at the end
            track.delete()

    A chain of frames is smoothed as one; a re-initialised track begins another. The memory is a file,
    and what is held of it does not grow with the recording.

    Args:
        path: of the file, beside the result.
        smoother: the backward pass.
        describe: makes the estimates.
        kept: of an interrupted run; None for nothing.

    Raises:
        ResultError: here and in every method, when the file cannot be written or read, or holds what no run
            wrote.
    """

    def __init__(
        self, path: Path, smoother: Smoother, describe: Describe[Described], kept: Kept | None = None
    ) -> None:
        self._path, self._smoother, self._describe = path, smoother, describe
        if kept is None:
            self._spool = RecordSpool(path)
            return
        like = _record(_NO_FRAME, smoother.remember(kept.state, Step(0.0, True, kept.frame)), kept.frame)
        self._spool = RecordSpool(path, kept.frames, like)
        try:
            smoother.resume(self._memory_of(next(reversed(self._spool))))
        except BaseException:
            self._spool.close()
            raise

    def __len__(self) -> int:
        return len(self._spool)

    def remember(self, state: Any, facts: FrameFacts, dt: float, cut: bool, frame: Memory = NOTHING) -> None:
        """Keep what is known after a frame.

        Args:
            state: as the smoother remembers it, such as a filter's.
            facts: what was written of the frame.
            dt: seconds that the state advanced by to this frame; 0 if it stood still.
            cut: whether the state does not follow from the frame before: at the first, or re-initialised.
            frame: what is kept of it besides, for the smoother's fits and for ``describe``.
        """
        numbers = facts._asdict() | {"status": STATUSES.index(facts.status), "cut": int(cut), "dt": dt}
        numbers["confidence"] = float(facts.confidence)
        about = {name: numbers[name] for name in _NO_FRAME}
        self._spool.append(_record(about, self._smoother.remember(state, Step(dt, cut, frame)), frame))

    def flush(self) -> None:
        """Wait until everything is on the disk."""
        self._spool.flush()

    def backward(self) -> Iterator[Described]:
        """Yield what is made of the smoothed states, the last frame first.

        Status and confidence are those of the filter, which say whether the frame itself was understood.
        """
        later, ends, dt = None, True, 0.0
        for record in reversed(self._spool):
            memory = self._memory_of(record)
            if later is None or ends:
                later = self._smoother.begin(memory)
            else:
                later = self._smoother.back(memory, dt) if dt > 0.0 else self._smoother.stay(memory, later)
            ends, dt = bool(record["cut"]), float(record["dt"])
            yield self._describe(later, _facts(record), memory | _named(record, BESIDES))

    def delete(self) -> None:
        """Remove the file."""
        self._spool.delete()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Let the file lie, for a run that is resumed."""
        self._spool.close()

    def _memory_of(self, record: dict[str, Array]) -> dict[str, Array]:
        """What of a record is the smoother's, once all of the record is known to be what a run wrote."""
        try:
            check_arrays(record, _layouts(record))
        except LayoutError as error:
            what = "spool cannot be used"
            raise ResultError(what, where=self._path, found=error, hint=RESTART_HINT) from error
        return _named(record, KEPT)


def smoothing_path(output: Path) -> Path:
    """The file beside a result in which a run remembers what it will smooth."""
    return output.with_name(f"{output.name}.part.frames")


def _facts(record: Mapping[str, Array]) -> FrameFacts:
    return FrameFacts(
        int(record["frame_index"]),
        int(record["stamp_ns"]),
        STATUSES[int(record["status"])],
        float(record["confidence"]),
    )


def _record(about: Mapping[str, float], memory: Memory, frame: Memory) -> dict[str, Array]:
    """The record of a frame; what a smoother has kept of it itself is not kept twice."""
    kept = {f"{KEPT}{name}": values for name, values in memory.items()}
    besides = {f"{BESIDES}{name}": values for name, values in frame.items() if name not in memory}
    return {name: np.asarray(value) for name, value in (dict(about) | kept | besides).items()}


def _named(record: Mapping[str, Array], prefix: str) -> dict[str, Array]:
    """What of a record has names that begin with this, which is taken off."""
    named = ((name, values) for name, values in record.items() if name.startswith(prefix))
    return {name.removeprefix(prefix): values for name, values in named}


def _layouts(record: Mapping[str, Array]) -> dict[str, Layout]:
    """What the values of a record must be; its types and shapes are those of all others."""
    most = float(STAMPS_NS[1])
    layouts = {
        name: Layout(values.dtype.name, values.shape, -np.inf if values.ndim else 0.0, most)
        for name, values in record.items()
    }
    layouts["status"] = counts(most=len(STATUSES) - 1)
    layouts["cut"] = counts(most=1)
    layouts["dt"] = floats(least=0.0)
    return layouts
