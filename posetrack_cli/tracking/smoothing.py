"""Smoothed tracks: the smoother's per-frame data, spooled to disk and processed backwards."""

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
KEPT, EXTRA = "filter.", "frame."
"""Record name prefixes: of the smoother's data, and of additional data for ``describe``."""
_NO_FRAME = {"frame_index": 0, "stamp_ns": 0, "status": 0, "cut": 0, "dt": 0.0, "confidence": 0.0}


class FrameFacts(NamedTuple):
    """Fields of ``Estimate`` that smoothing does not change."""

    frame_index: int
    stamp_ns: int
    status: Status
    confidence: float

    @classmethod
    def of(cls, estimate: Estimate) -> FrameFacts:
        """Return the facts of an estimate."""
        return cls(*(getattr(estimate, name) for name in cls._fields))


Describe: TypeAlias = Callable[[Smoothed, FrameFacts, Memory], Described]
"""Creates the output from a smoothed state, its frame, and the data stored for it."""


class Kept(NamedTuple):
    """Expected contents of an interrupted run's file.

    Attributes:
        frames: number of frames to keep, at least 1.
        state: any state that the smoother stores, and
        frame: additional data of any frame; together they define the expected arrays.
    """

    frames: int
    state: Any
    frame: Memory = NOTHING


class SmoothedTrack(Generic[Described]):
    """Stores every frame of a run, then smooths them from last to first.

        with SmoothedTrack(path, smoother, describe, kept) as track:
            track.remember(state.particles, FrameFacts.of(estimate), dt, cut, frame)  # each frame
            track.flush()                                           # before a checkpoint
            for estimate in track.backward(): ...                   # at the end
            track.delete()

    Frames are smoothed in chains; a reinitialised track starts a new chain. Frames are stored in a file, so
    memory does not grow with the recording.

    Args:
        path: file next to the result.
        smoother: backward pass.
        describe: creates the estimates.
        kept: contents to keep from an interrupted run; None for a new file.

    Raises:
        ResultError: here and in every method: the file cannot be written or read, or has invalid contents.
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
        """Store the data of a frame.

        Args:
            state: state for the smoother, such as a filter's.
            facts: facts about the frame.
            dt: seconds by which the state advanced to this frame; 0 if it did not.
            cut: whether the state does not follow from the previous frame: first frame or reinitialised.
            frame: additional data for the smoother's fits and for ``describe``.
        """
        numbers = facts._asdict() | {"status": STATUSES.index(facts.status), "cut": int(cut), "dt": dt}
        numbers["confidence"] = float(facts.confidence)
        about = {name: numbers[name] for name in _NO_FRAME}
        self._spool.append(_record(about, self._smoother.remember(state, Step(dt, cut, frame)), frame))

    def flush(self) -> None:
        """Sync everything to disk."""
        self._spool.flush()

    def backward(self) -> Iterator[Described]:
        """Yield the outputs of the smoothed states, last frame first.

        Status and confidence are the filter's, as they describe how well the frame itself was tracked.
        """
        later, ends, dt = None, True, 0.0
        for record in reversed(self._spool):
            memory = self._memory_of(record)
            if later is None or ends:
                later = self._smoother.begin(memory)
            else:
                later = self._smoother.back(memory, dt) if dt > 0.0 else self._smoother.stay(memory, later)
            ends, dt = bool(record["cut"]), float(record["dt"])
            yield self._describe(later, _facts(record), memory | _named(record, EXTRA))

    def delete(self) -> None:
        """Delete the file."""
        self._spool.delete()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Close the file but keep it for resuming."""
        self._spool.close()

    def _memory_of(self, record: dict[str, Array]) -> dict[str, Array]:
        """Return the smoother's part of a record after checking the whole record."""
        try:
            check_arrays(record, _layouts(record))
        except LayoutError as error:
            what = "spool cannot be used"
            raise ResultError(what, where=self._path, found=error, hint=RESTART_HINT) from error
        return _named(record, KEPT)


def smoothing_path(output: Path) -> Path:
    """Return the file next to a result that stores the frames to be smoothed."""
    return output.with_name(f"{output.name}.part.frames")


def _facts(record: Mapping[str, Array]) -> FrameFacts:
    return FrameFacts(
        int(record["frame_index"]),
        int(record["stamp_ns"]),
        STATUSES[int(record["status"])],
        float(record["confidence"]),
    )


def _record(about: Mapping[str, float], memory: Memory, frame: Memory) -> dict[str, Array]:
    """Return a frame's record; data that the smoother already stores is not duplicated."""
    kept = {f"{KEPT}{name}": values for name, values in memory.items()}
    besides = {f"{EXTRA}{name}": values for name, values in frame.items() if name not in memory}
    return {name: np.asarray(value) for name, value in (dict(about) | kept | besides).items()}


def _named(record: Mapping[str, Array], prefix: str) -> dict[str, Array]:
    """Return the entries with a name prefix, without the prefix."""
    named = ((name, values) for name, values in record.items() if name.startswith(prefix))
    return {name.removeprefix(prefix): values for name, values in named}


def _layouts(record: Mapping[str, Array]) -> dict[str, Layout]:
    """Return value ranges for a record; types and shapes are checked by the spool's header."""
    most = float(STAMPS_NS[1])
    layouts = {
        name: Layout(values.dtype.name, values.shape, -np.inf if values.ndim else 0.0, most)
        for name, values in record.items()
    }
    layouts["status"] = counts(most=len(STATUSES) - 1)
    layouts["cut"] = counts(most=1)
    layouts["dt"] = floats(least=0.0)
    return layouts
