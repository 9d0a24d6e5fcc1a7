"""Instants of a synthetic recording, and what recordings of hands and heads share."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any, Protocol, TypeVar

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray, IntArray
from posetrack_cli.build import version
from posetrack_cli.errors import UsageError
from posetrack_cli.mcap.sink import McapSink, serialised
from posetrack_cli.outputs import whole_or_nothing
from posetrack_cli.recording.base import TRUTH_PREFIX
from posetrack_cli.recording.conversion import CHUNK_BYTES
from posetrack_cli.results import messages
from posetrack_cli.results.estimate import Estimate, Subject
from posetrack_cli.results.estimate_json import ESTIMATE_SCHEMA, ESTIMATE_SCHEMA_NAME, estimate_to_json

# When the frames of a synthetic recording are taken, and which frames or images are missing


START_NS = 1_000_000_000
"""Stamp of the first frame: not 0, which some readers take for "no stamp"."""

DROP_PROBABILITY = 0.02
BURST_SHARE = 0.2
"""Share of the drops that take 2 to 4 frames at once."""

LATE_PROBABILITY = 0.1
LATE_S = (0.002, 0.015)
MOST_LATE = 0.45
"""A frame is late by at most this part of the frame interval, so that order is kept at any rate."""

BURSTS_PER_FRAME, LONGEST_BURST = 0.01, 12
"""Of images that one camera misses: a burst takes 1 to so many."""


@dataclass(frozen=True)
class Timeline:
    """The instants of a recording.

    Attributes:
        stamps_ns: (T,) when each frame is taken, strictly increasing; also of the dropped ones.
        dropped: (T,) which frames are missing, or (C, T) which image of each camera; never the first.
    """

    stamps_ns: IntArray
    dropped: BoolArray

    @property
    def seconds(self) -> FloatArray:
        """(T,) time since the first frame, s."""
        return np.asarray((self.stamps_ns - self.stamps_ns[0]) * 1e-9, dtype=np.float64)


def make_timeline(frames: int, fps: float, *, drops: bool, late: bool, rng: np.random.Generator) -> Timeline:
    """Return the instants of a recording.

    Each frame is dropped with probability ``DROP_PROBABILITY`` / (mean burst length), which begins a
    burst of 2 to 4 in one case of five; each is late with probability ``LATE_PROBABILITY`` by a time
    uniform in ``LATE_S``.

    Args:
        frames: number of instants.
        fps: nominal rate, Hz.
        drops: whether frames are dropped.
        late: whether frames are late.
        rng: draws the same numbers whatever the switches are.
    """
    delays = _delays(frames, fps, rng)
    dropped = _dropped(frames, rng)
    nominal = nominal_stamps(frames, fps)
    stamps = nominal + np.rint(delays * 1e9).astype(np.int64) if late else nominal
    return Timeline(stamps, dropped if drops else np.zeros(frames, dtype=np.bool_))


def nominal_stamps(frames: int, fps: float) -> IntArray:
    """Return the stamps (T,) ns of frames that are all on time, at a rate in Hz."""
    since = np.rint(np.arange(frames) * (1e9 / fps)).astype(np.int64)
    return np.asarray(START_NS + since, dtype=np.int64)


def _delays(frames: int, fps: float, rng: np.random.Generator) -> FloatArray:
    chosen = rng.random(frames) < LATE_PROBABILITY
    delays = np.where(chosen, rng.uniform(*LATE_S, frames), 0.0)
    delays[0] = 0.0
    return np.minimum(delays, MOST_LATE / fps)


def _dropped(frames: int, rng: np.random.Generator) -> BoolArray:
    lengths = np.where(rng.random(frames) < BURST_SHARE, rng.integers(2, 5, frames), 1)
    mean_length = 1.0 + 2.0 * BURST_SHARE
    begins = rng.random(frames) < DROP_PROBABILITY / mean_length
    dropped = np.zeros(frames, dtype=np.bool_)
    for first in np.flatnonzero(begins):
        dropped[first : first + lengths[first]] = True
    dropped[0] = False
    return dropped


def dropped_images(cameras: int, frames: int, rng: np.random.Generator) -> BoolArray:
    """Return which images (C, T) are missing: never of the first frame, never all of a frame of several."""
    dropped = np.zeros((cameras, frames), dtype=np.bool_)
    for row in dropped:
        for first in np.flatnonzero(rng.random(frames) < BURSTS_PER_FRAME):
            row[first : first + rng.integers(1, LONGEST_BURST + 1)] = True
    dropped[:, 0] = False
    if cameras > 1:
        dropped[0, dropped.all(axis=0)] = False
    return dropped


# A synthetic recording as hands and heads share it: its frames, its truth, its file


SYNTH_RECORD = "posetrack.synth"
"""The metadata that tells how a recording was made."""


class SyntheticFrame(Protocol):
    """What every frame tells of itself."""

    @property
    def stamp_ns(self) -> int:
        """When it was taken, integer nanoseconds; the truth is of the same time."""

    def truth(self) -> Estimate:
        """The truth as an estimate without doubt: confidence 1, all variances 0, no particles."""

    def joint_states(self) -> messages.JointStates:
        """What moves in itself: the angles of fingers, the strengths of expressions."""


Frame = TypeVar("Frame", bound=SyntheticFrame)
FrameContra = TypeVar("FrameContra", bound=SyntheticFrame, contravariant=True)


class Writer(Protocol[FrameContra]):
    """Puts frames on their topics."""

    def write(self, frame: FrameContra) -> None:
        """Write one frame and the truth about it."""


@dataclass(frozen=True)
class Synthesis:
    """What was written.

    Attributes:
        frames: number of frames written.
        missing: number of frames, or of images of several cameras, that were left out.
        seconds: from the first to the last frame's stamp.
    """

    frames: int
    missing: int
    seconds: float


def check_option(name: str, value: object, good: bool, expected: str) -> None:
    """Raise UsageError, which names an option, unless its value can be used."""
    if not good:
        raise UsageError(f"--{name} cannot be used", found=value, expected=expected)


def reported(frames: Iterator[Frame], report: Callable[[Frame], None]) -> Iterator[Frame]:
    """Yield frames, each after it was reported."""
    for frame in frames:
        report(frame)
        yield frame


def synth_record(options: Any, facts: Mapping[str, str]) -> dict[str, str]:
    """Return the metadata that tells how a recording was made: the options of one value each, and facts.

    Args:
        options: a dataclass.
        facts: what else is told.
    """
    values = {field.name: getattr(options, field.name) for field in fields(options)}
    plain = {name: str(value) for name, value in values.items() if not is_dataclass(value)}
    return dict(sorted({"version": version(), **plain, **facts}.items()))


def numbers_text(values: Any) -> str:
    """Return numbers as metadata has them."""
    return " ".join(f"{value:.6g}" for value in np.ravel(values))


@contextmanager
def recording_file(out: Path) -> Iterator[McapSink]:
    """Yield the MCAP file of a recording: ``out`` + ``.part``, renamed when it is complete.

    Raises:
        ResultError: the file cannot be written.
    """
    with (
        whole_or_nothing(out) as part,
        McapSink(part, compression="none", chunk_bytes=CHUNK_BYTES) as sink,
    ):
        yield sink


def write_all(
    sink: McapSink,
    record: Mapping[str, str],
    frames: Iterator[Frame],
    writer: Callable[[McapSink], Writer[Frame]],
) -> None:
    """Write the metadata ``posetrack.synth`` and all frames, and finish the file."""
    sink.metadata(SYNTH_RECORD, record)
    opened = writer(sink)
    for frame in frames:
        opened.write(frame)
    sink.finish()


class TruthChannels:
    """Writes truth below ``/truth/SUBJECT/``: ``odometry`` and ``estimate``, as results do, and joint states.

    Args:
        sink: where to.
        subject: who it is about.
        joints: the last part of the joint states' topic.
    """

    def __init__(self, sink: McapSink, subject: Subject, joints: str) -> None:
        self._sink, self._subject = sink, subject
        prefix = f"{TRUTH_PREFIX}{subject.name}"
        self._odometry = sink.channel(f"{prefix}/odometry", messages.Odometry)
        self._joints = sink.channel(f"{prefix}/{joints}", messages.JointStates)
        self._estimate = sink.json_channel(f"{prefix}/estimate", ESTIMATE_SCHEMA_NAME, ESTIMATE_SCHEMA)

    def write(self, frame: SyntheticFrame) -> None:
        """Write the truth about one frame."""
        truth = frame.truth()
        self._sink.write(self._odometry, frame.stamp_ns, serialised(messages.odometry(truth, self._subject)))
        self._sink.write(self._joints, frame.stamp_ns, serialised(frame.joint_states()))
        self._sink.write(self._estimate, frame.stamp_ns, estimate_to_json(truth))
