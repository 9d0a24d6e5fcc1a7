"""Options of a run, and deviations from print."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from pathlib import Path
from typing import NamedTuple

from posetrack_cli.build import build_record
from posetrack_cli.configuration import Settings
from posetrack_cli.errors import RecordingError, UsageError
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.losses import Loss, loss_line
from posetrack_cli.recording.base import PATH_KEY
from posetrack_cli.recording.identity import shown_path
from posetrack_cli.recording.recording import Recording

# What a run is asked for, what a result states of it, and what came of it


LEAST_TRACKED = 0.05
"""Share of frames that a run must track, or it is not a success."""


@dataclass(frozen=True)
class RunOptions:
    """What a run depends on besides recording and configuration.

    Attributes:
        output: the result's path.
        seed: of the random generator.
        init: how the start is found; None as configured.
        start, end, stride: which frames.
        resume: go on with an interrupted run.
        overwrite: replace an existing result.
        timings: write each frame's milliseconds; then two runs differ in their bytes.
        smooth: also write the smoothed track.
    """

    output: Path
    seed: int = 0
    init: str | None = None
    start: int = 0
    end: int | None = None
    stride: int = 1
    resume: bool = False
    overwrite: bool = False
    timings: bool = False
    smooth: bool = False


@dataclass(frozen=True)
class RunOutcome:
    """What came of a run.

    Attributes:
        frames: estimates in the result, also those of a run that was resumed.
        tracked: frames tracked now.
        lost: estimates in the result with status lost.
        seconds: wall-clock time of its frames, in all passes: without compiling, and without the smoothed
            track.
        losses: data that could not be used.
        stopped: whether it was interrupted.
        remarks: what else a user should know, one line each.
        failure: what the images show of which hardly any was tracked, one line; empty for a success.
    """

    frames: int
    tracked: int
    lost: int
    seconds: float
    losses: tuple[Loss, ...]
    stopped: bool
    remarks: tuple[str, ...] = ()
    failure: str = ""


def is_hardly_tracked(frames: int, lost: int) -> bool:
    """Return whether so many of a result's frames are lost that it is not a success."""
    return frames - lost < LEAST_TRACKED * frames


def frames_ahead(recording: Recording, options: RunOptions) -> int | None:
    """How many frames of the recording a run goes through, None when that shows only in reading it."""
    count = recording.frame_count
    if count is None:
        return None
    end = count if options.end is None else min(count, options.end)
    return len(range(options.start, end, options.stride))


def nothing_to_track(recording: Recording) -> UsageError | RecordingError:
    """The error of a run that finds no frame: the options' fault, or the recording's."""
    losses = recording.losses
    if losses:
        return RecordingError("no frame can be tracked", where=recording.path, found=loss_line(losses))
    count = recording.frame_count
    found = "none that can be read" if count is None else f"{count} frames"
    return UsageError("no frame to track", where=recording.path, found=found, hint="check --start and --end")


def common_record(
    tracker: str, recording: Recording, camera: Camera, config: Settings, options: RunOptions
) -> dict[str, str]:
    """Return what the records of all trackers' runs state.

    Args:
        tracker: its name.
        recording: its identity is stated, and its path as it was typed.
        camera: that estimates are relative to, with the intrinsics that are used.
        config: resolved, with the defaults.
        options: frames and seed.
    """
    return {
        "tracker": tracker,
        **build_record(),
        "configuration": json.dumps(config.model_dump(mode="json")),
        "seed": str(options.seed),
        "start": str(options.start),
        "end": "" if options.end is None else str(options.end),
        "stride": str(options.stride),
        "timings": str(options.timings).lower(),
        "camera": json.dumps(camera.values()),
        PATH_KEY: shown_path(recording.path),
        **{f"input.{key}": value for key, value in recording.identity().items()},
    }


# Where a run differs from the paper that its configuration follows, item by item


RECORD_KEY = "deviations_from_print"
"""Of the run record: a JSON list of lines; only of configurations that follow a paper."""


class PrintedSetting(NamedTuple):
    """A configuration key that has a value as printed.

    Attributes:
        where: section or equation.
        key: such as ``filter.gain``.
        value: as printed.
    """

    where: str
    key: str
    value: object


class Deviation(NamedTuple):
    """What no configuration key turns into what is printed.

    Attributes:
        where: section or equation.
        text: what is done instead, one clause.
    """

    where: str
    text: str


def deviations(
    config: Settings, settings: Sequence[PrintedSetting], always: Sequence[Deviation]
) -> list[str]:
    """Return a line for each setting in force that is not as printed, then for each constant deviation."""
    differing = [(one, _value(config, one.key)) for one in settings]
    return [
        f"{one.where}: {one.key} is {_shown(value)}, not {_shown(one.value)}"
        for one, value in differing
        if value != one.value
    ] + [f"{one.where}: {one.text}" for one in always]


def _value(config: Settings, key: str) -> object:
    return reduce(getattr, key.split("."), config)


def _shown(value: object) -> str:
    return repr(value) if isinstance(value, str) else str(value)


def deviations_record(lines: Sequence[str] | None) -> dict[str, str]:
    """Return what a run record says of deviations; nothing where no paper is followed."""
    return {} if lines is None else {RECORD_KEY: json.dumps(lines)}
