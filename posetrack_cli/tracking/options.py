"""Options and outcome of a run, its record, and deviations from a paper."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
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

# Options, outcome and run record

LEAST_TRACKED = 0.05
"""Minimum share of tracked frames for a run to succeed."""


@dataclass(frozen=True)
class RunOptions:
    """Options of a run, in addition to recording and configuration.

    Attributes:
        output: path of the result.
        seed: seed of the random generator.
        init: initialisation method; None as configured.
        start, end, stride: selected frames.
        resume: continue an interrupted run.
        overwrite: replace an existing result.
        timings: record each frame's milliseconds, which makes equal runs differ in their bytes.
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
    """Outcome of a run.

    Attributes:
        frames: estimates in the result, including those before a resume.
        tracked: frames tracked by this process.
        lost: estimates with status lost in the result; with several subjects, of the one with the fewest.
        seconds: wall-clock time of the frames in all passes, without compilation and the smoothed track.
        losses: data that could not be used.
        stopped: whether the run was interrupted.
        remarks: further notes for the user, one line each.
        failure: likely reason, in one line, if hardly any frame was tracked; empty on success.
        lost_by_label: lost estimates of each of several subjects.
    """

    frames: int
    tracked: int
    lost: int
    seconds: float
    losses: tuple[Loss, ...]
    stopped: bool
    remarks: tuple[str, ...] = ()
    failure: str = ""
    lost_by_label: Mapping[str, int] = field(default_factory=dict)


def is_hardly_tracked(frames: int, lost: int) -> bool:
    """Return whether too many frames are lost for the run to count as a success."""
    return frames - lost < LEAST_TRACKED * frames


def frames_ahead(recording: Recording, options: RunOptions) -> int | None:
    """Return the number of frames to process, or None if only reading the recording shows it."""
    count = recording.frame_count
    if count is None:
        return None
    end = count if options.end is None else min(count, options.end)
    return len(range(options.start, end, options.stride))


def nothing_to_track(recording: Recording) -> UsageError | RecordingError:
    """Return the error for a run without frames, blaming the options or the recording."""
    losses = recording.losses
    if losses:
        return RecordingError("no readable frames", where=recording.path, found=loss_line(losses))
    count = recording.frame_count
    found = "no readable frames" if count is None else f"{count} frames"
    return UsageError("no frames to track", where=recording.path, found=found, hint="check --start and --end")


def common_record(
    tracker: str, recording: Recording, camera: Camera, config: Settings, options: RunOptions
) -> dict[str, str]:
    """Return the run record entries shared by all trackers.

    Args:
        tracker: tracker name.
        recording: recording; its identity and its path as typed are stored.
        camera: reference camera, with the intrinsics in use.
        config: resolved configuration, including defaults.
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


# Deviations of a run from the paper that its configuration follows

RECORD_KEY = "deviations_from_print"
"""Run record key of a JSON list of lines, for configurations that follow a paper."""


class PrintedSetting(NamedTuple):
    """Configuration key with the value given in the paper.

    Attributes:
        where: section or equation.
        key: configuration key such as ``filter.gain``.
        value: value in the paper.
    """

    where: str
    key: str
    value: object


class Deviation(NamedTuple):
    """Deviation from the paper that no configuration key can undo.

    Attributes:
        where: section or equation.
        text: what is done instead, one clause.
    """

    where: str
    text: str


def deviations(
    config: Settings, settings: Sequence[PrintedSetting], always: Sequence[Deviation]
) -> list[str]:
    """Return a line for each setting that differs from the paper, then for each constant deviation."""
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
    """Return the run record entry for deviations; empty if no paper is followed."""
    return {} if lines is None else {RECORD_KEY: json.dumps(lines)}
