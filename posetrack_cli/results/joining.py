"""Joining of results of one recording: each contributes some of the frames, messages unchanged."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from mcap.records import Attachment

from posetrack_cli.errors import ResultError
from posetrack_cli.mcap.stream import McapFile
from posetrack_cli.recording.base import TRUTH_PREFIX, TruthMessage
from posetrack_cli.recording.topics import CALIBRATION, CAMERA_PREFIX, PLACES_TOPIC
from posetrack_cli.results.estimate import Estimate
from posetrack_cli.results.estimate_json import estimate_from_json
from posetrack_cli.results.reader import Result, read_result
from posetrack_cli.results.topics import FILTERED, SMOOTHED, SMOOTHED_PREFIX
from posetrack_cli.results.writer import ResultWriter

_FLUSH_FRAMES = 10


class Message(NamedTuple):
    """Message of a result.

    Attributes:
        topic: topic name.
        stamp_ns: log time.
        data: message bytes.
    """

    topic: str
    stamp_ns: int
    data: bytes


@dataclass(frozen=True)
class Share:
    """Frames that one result contributes.

    Attributes:
        path: finished result.
        first, last: frame range, ``last`` excluded.
    """

    path: Path
    first: int
    last: int

    def holds(self, estimate: Estimate) -> bool:
        """Return whether the frame is in the range."""
        return self.first <= estimate.frame_index < self.last


def join_results(
    shares: Sequence[Share], output: Path, changes: Mapping[str, str], *, overwrite: bool = False
) -> None:
    """Join results into one: the frames of each share, in this order, with everything that belongs to them.

    The run record is that of the first result plus ``changes`` and the processors of all; attachments are
    those of the first. Equal inputs give equal bytes. Only one frame is in memory at a time.

    Args:
        shares: consecutive frame ranges of one recording and subject.
        output: joined result.
        changes: entries to change in the run record.
        overwrite: whether an existing result may be replaced.

    Raises:
        ResultError: a result is missing, unfinished, damaged or of another recording, or the output cannot
            be written.
        UsageError: the output exists and may not be replaced.
    """
    results = [read_result(share.path) for share in shares]
    first = results[0]
    camera, *others = first.cameras()
    for result in results:
        _check(result, first)
    run = {**first.run, **changes}
    processors = dict.fromkeys(result.run.get("processor", "") for result in results)
    if len(processors) > 1:
        run["processor"] = "; ".join(processors)
    with ResultWriter(
        output,
        first.subject,
        camera,
        run,
        others=others,
        flush_frames=_flush_frames(first),
        overwrite=overwrite,
    ) as writer:
        after_ns = -1
        for share, result in zip(shares, results, strict=True):
            after_ns = _copy_filtered(writer, result, share, after_ns)
        if all(SMOOTHED in result.tracks for result in results):
            for share, result in reversed(list(zip(shares, results, strict=True))):
                for messages, estimate in _frames(result, SMOOTHED):
                    if share.holds(estimate):
                        writer.copy_smoothed(messages, estimate)
        for record in McapFile(first.path).extras():
            if isinstance(record, Attachment):
                writer.attach(record.name, record.media_type, record.data)
        writer.finish(_summary(shares, results))


def _check(result: Result, first: Result) -> None:
    if not result.finished:
        raise ResultError("is unfinished and cannot be joined", where=result.path)
    for (what, value), expected in zip(_identity(result).items(), _identity(first).values(), strict=True):
        if value != expected:
            raise ResultError(f"has a different {what}", where=result.path, expected=f"that of {first.path}")


def _identity(result: Result) -> dict[str, object]:
    """Return the properties that results must share to be joined."""
    subject = result.subject
    return {
        "subject": (subject.name, subject.shape_names, subject.point_names),
        "camera": tuple(camera.values() for camera in result.cameras()),
        "recording": result.run.get("input.sha256"),
    }


def _copy_filtered(writer: ResultWriter, result: Result, share: Share, after_ns: int) -> int:
    """Copy a share, with ground truth up to each frame; return the stamp of its last frame."""
    truth = _truth_after(result, after_ns)
    message = next(truth, None)
    for messages, estimate in _frames(result, FILTERED):
        if not share.holds(estimate):
            continue
        while message is not None and message.log_time_ns <= estimate.stamp_ns:
            writer.add_truth(message)
            message = next(truth, None)
        writer.copy(messages, estimate)
        after_ns = estimate.stamp_ns
    if result.losses:
        raise ResultError("is damaged and cannot be joined", where=result.path, found=result.losses[0].what)
    return after_ns


def _truth_after(result: Result, after_ns: int) -> Iterator[TruthMessage]:
    if result.truth_topics:
        yield from (message for message in result.truth() if message.log_time_ns > after_ns)


def _frames(result: Result, track: str) -> Iterator[tuple[list[Message], Estimate]]:
    """Yield the messages of each frame of a track, and the estimate among them."""
    topic = result.topic_of_track(track)
    wanted = {channel.topic for _, channel in result.channels if _is_of_track(channel.topic, track)}
    messages: list[Message] = []
    estimate: Estimate | None = None
    for _, channel, message in McapFile(result.path).messages(wanted, in_file_order=True):
        if estimate is not None and message.log_time != estimate.stamp_ns:
            yield messages, estimate
            messages, estimate = [], None
        messages.append(Message(channel.topic, message.log_time, message.data))
        if channel.topic == topic:
            estimate = estimate_from_json(message.data, result.path)
    if estimate is not None:
        yield messages, estimate


def _is_of_track(topic: str, track: str) -> bool:
    """Return whether a topic has per-frame messages of the track; static cameras and truth are excluded."""
    if topic.startswith(SMOOTHED_PREFIX):
        return track == SMOOTHED
    is_camera = topic.startswith(f"{CAMERA_PREFIX}/") and topic.endswith(f"/{CALIBRATION}")
    is_apart = is_camera or topic == PLACES_TOPIC or topic.startswith(TRUTH_PREFIX)
    return track == FILTERED and not is_apart


def _summary(shares: Sequence[Share], results: Sequence[Result]) -> dict[str, str]:
    """Return the summaries' texts, labelled by frame range; the writer counts frames itself."""
    texts: dict[str, str] = {}
    for name in ("losses", "remarks"):
        lines = [
            f"frames {share.first} to {share.last - 1}: {result.summary[name]}"
            for share, result in zip(shares, results, strict=True)
            if result.summary.get(name)
        ]
        if lines:
            texts[name] = "; ".join(lines)
    return texts


def _flush_frames(result: Result) -> int:
    """Return the result's flush interval, as it determines chunk boundaries."""
    with suppress(KeyError, TypeError, ValueError):
        return max(1, int(json.loads(result.run["configuration"])["output"]["flush_frames"]))
    return _FLUSH_FRAMES
