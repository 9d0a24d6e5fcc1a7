"""Common parts of synthetic recordings of hands and heads: timeline, truth, file."""

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
from posetrack_cli.results.estimate_json import ESTIMATE_SCHEMA_NAME, estimate_schema, estimate_to_json

# Timeline: stamps, late and missing frames

START_NS = 1_000_000_000
"""Stamp of the first frame; not 0, which some readers interpret as "no stamp"."""

DROP_PROBABILITY = 0.02
BURST_SHARE = 0.2
"""Share of drops that last 2 to 4 frames."""

LATE_PROBABILITY = 0.1
LATE_S = (0.002, 0.015)
MOST_LATE = 0.45
"""Maximum delay as a fraction of the frame interval, which preserves the order at any rate."""

BURSTS_PER_FRAME, LONGEST_BURST = 0.01, 12
"""Rate and maximum length of image drops of a single camera."""


@dataclass(frozen=True)
class Timeline:
    """Instants of a recording.

    Attributes:
        stamps_ns: (T,) stamps of all frames, including dropped ones, strictly increasing.
        dropped: (T,) missing frames, or (C, T) missing images per camera; never the first.
    """

    stamps_ns: IntArray
    dropped: BoolArray

    @property
    def seconds(self) -> FloatArray:
        """(T,) time since the first frame, s."""
        return np.asarray((self.stamps_ns - self.stamps_ns[0]) * 1e-9, dtype=np.float64)


def make_timeline(frames: int, fps: float, *, drops: bool, late: bool, rng: np.random.Generator) -> Timeline:
    """Draw the instants of a recording.

    Drops start with probability ``DROP_PROBABILITY`` / (mean drop length) per frame; one in five is a burst
    of 2 to 4 frames. Frames are late with probability ``LATE_PROBABILITY``, by a time uniform in
    ``LATE_S``.

    Args:
        frames: number of instants.
        fps: nominal rate, Hz.
        drops: whether frames are dropped.
        late: whether frames are late.
        rng: random generator; the number of draws does not depend on the switches.
    """
    delays = _delays(frames, fps, rng)
    dropped = _dropped(frames, rng)
    nominal = nominal_stamps(frames, fps)
    stamps = nominal + np.rint(delays * 1e9).astype(np.int64) if late else nominal
    return Timeline(stamps, dropped if drops else np.zeros(frames, dtype=np.bool_))


def nominal_stamps(frames: int, fps: float) -> IntArray:
    """Return stamps (T,), ns, at a constant rate, Hz."""
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
    """Draw the missing images (C, T): never in the first frame, never all images of a frame."""
    dropped = np.zeros((cameras, frames), dtype=np.bool_)
    for row in dropped:
        for first in np.flatnonzero(rng.random(frames) < BURSTS_PER_FRAME):
            row[first : first + rng.integers(1, LONGEST_BURST + 1)] = True
    dropped[:, 0] = False
    if cameras > 1:
        dropped[0, dropped.all(axis=0)] = False
    return dropped


# Frames, ground truth, file

SYNTH_RECORD = "posetrack.synth"
"""Metadata record with the options of the recording."""


class SyntheticFrame(Protocol):
    """Common interface of synthetic frames."""

    @property
    def stamp_ns(self) -> int:
        """Time of the frame and its ground truth, integer nanoseconds."""

    def truth(self) -> Estimate:
        """Return the ground truth as an estimate with confidence 1 and zero variances."""

    def joint_states(self) -> messages.JointStates:
        """Return internal degrees of freedom: finger angles, strengths of expressions."""


Frame = TypeVar("Frame", bound=SyntheticFrame)
FrameContra = TypeVar("FrameContra", bound=SyntheticFrame, contravariant=True)


class Writer(Protocol[FrameContra]):
    """Writer of frames to their topics."""

    def write(self, frame: FrameContra) -> None:
        """Write one frame and its ground truth."""


@dataclass(frozen=True)
class Synthesis:
    """Statistics of a written recording.

    Attributes:
        frames: number of frames written.
        missing: number of dropped frames, or dropped images with several cameras.
        seconds: time from the first to the last frame.
    """

    frames: int
    missing: int
    seconds: float


def check_option(name: str, value: object, good: bool, expected: str) -> None:
    """Raise a UsageError naming the option unless its value is valid."""
    if not good:
        raise UsageError(f"invalid --{name}", found=value, expected=expected)


def reported(frames: Iterator[Frame], report: Callable[[Frame], None]) -> Iterator[Frame]:
    """Yield frames, each after reporting it."""
    for frame in frames:
        report(frame)
        yield frame


def synth_record(options: Any, facts: Mapping[str, str]) -> dict[str, str]:
    """Return the metadata of a recording: scalar options and further facts.

    Args:
        options: a dataclass.
        facts: additional entries.
    """
    values = {field.name: getattr(options, field.name) for field in fields(options)}
    plain = {name: str(value) for name, value in values.items() if not is_dataclass(value)}
    return dict(sorted({"version": version(), **plain, **facts}.items()))


def numbers_text(values: Any) -> str:
    """Return numbers as metadata text."""
    return " ".join(f"{value:.6g}" for value in np.ravel(values))


@contextmanager
def recording_file(out: Path) -> Iterator[McapSink]:
    """Yield the MCAP file of a recording, written as ``out`` + ``.part`` and renamed when complete.

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
    """Writer of ground truth below ``/truth/SUBJECT/``: ``odometry``, ``estimate`` and joint states.

    Args:
        sink: output file.
        subject: subject of the truth.
        joints: last part of the joint states topic.
    """

    def __init__(self, sink: McapSink, subject: Subject, joints: str) -> None:
        self._sink, self._subject = sink, subject
        prefix = f"{TRUTH_PREFIX}{subject.name}"
        self._odometry = sink.channel(f"{prefix}/odometry", messages.Odometry)
        self._joints = sink.channel(f"{prefix}/{joints}", messages.JointStates)
        schema = estimate_schema(subject.number_names)
        self._estimate = sink.json_channel(f"{prefix}/estimate", ESTIMATE_SCHEMA_NAME, schema)

    def write(self, frame: SyntheticFrame) -> None:
        """Write the ground truth of one frame."""
        truth = frame.truth()
        self._sink.write(self._odometry, frame.stamp_ns, serialised(messages.odometry(truth, self._subject)))
        self._sink.write(self._joints, frame.stamp_ns, serialised(frame.joint_states()))
        self._sink.write(self._estimate, frame.stamp_ns, estimate_to_json(truth, self._subject.number_names))
