"""Copies of results with metrics: per-frame metrics as topics, totals, gates and ground truth as metadata."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from mcap.records import Channel, Schema

from posetrack_cli import limits
from posetrack_cli.arrays import FloatArray
from posetrack_cli.build import version
from posetrack_cli.errors import ResultError, UsageError
from posetrack_cli.evaluation.judging.assessment import Assessment, Request, stated_options
from posetrack_cli.evaluation.measuring.catalogue import metric_of, place_of
from posetrack_cli.evaluation.measuring.evaluate import evaluate
from posetrack_cli.evaluation.measuring.evaluation import Evaluation
from posetrack_cli.evaluation.measuring.without_truth import run_series
from posetrack_cli.evaluation.reading.tracks import track_name, unique_names
from posetrack_cli.evaluation.reports.report_files import FORMAT, finite, result_values
from posetrack_cli.losses import Loss
from posetrack_cli.mcap.sink import McapSink
from posetrack_cli.mcap.stream import McapFile
from posetrack_cli.outputs import check_output, whole_or_nothing
from posetrack_cli.recording.identity import file_digest, identity_record, shown_name
from posetrack_cli.results.copying import Copied, copied_result, unchanged
from posetrack_cli.results.reader import read_result
from posetrack_cli.results.topics import topics_prefix

EVAL_PREFIX = "/eval/"
EVAL_RECORD = "posetrack.eval"
METRICS_SCHEMA_NAME = "posetrack.FrameMetrics"
_CHUNK_BYTES = limits.MIB
# Short chunks of metrics, so that readers which seek in time read them along with their frames.
_CHUNK_FRAMES = 100


def mcap_outputs(out: Path, results: Sequence[Path], *, overwrite: bool) -> dict[Path, Path]:
    """Return the output file of each result, and check that it can be written.

    Args:
        out: output file, or folder for one file per result.
        results: result files.
        overwrite: whether existing files may be replaced.

    Raises:
        UsageError: several results would be written to one file, or as for ``check_output``.
        ResultError: as for ``check_output``.
    """
    in_folder = out.is_dir() or len(results) > 1
    if not in_folder:
        check_output(out, overwrite=overwrite, source=results[0], source_name="result")
        return {results[0]: out}
    if (out.suffix == ".mcap" and not out.is_dir()) or out.is_file():
        found, expected = f"{len(results)} results for one file", "a folder"
        raise UsageError("output is not a folder", where=out, found=found, expected=expected)
    if not out.parent.is_dir():
        raise ResultError("cannot be written", where=out, found=f"no folder {out.parent}")
    names = [f"{name.replace('/', '-')}.mcap" for name in unique_names(results)]
    twice = next((name for name, count in Counter(names).items() if count > 1), None)
    if twice is not None:
        raise UsageError("two results have the same name", where=out / twice, hint="rename one of them")
    outputs = {result: out / name for result, name in zip(results, names, strict=True)}
    if out.is_dir():
        for result, written in outputs.items():
            check_output(written, overwrite=overwrite, source=result, source_name="result")
    return outputs


def write_mcaps(
    found: Assessment, request: Request, outputs: Mapping[Path, Path], tracks: Sequence[str] | None
) -> Iterator[tuple[str, tuple[Loss, ...]]]:
    """Write a copy of each evaluated result with its metrics; yield its name and its unreadable parts.

    In the layout ``rows``, which keeps no per-frame values, each result is evaluated again, so that only one
    is in memory at a time.

    Args:
        found: the assessment.
        request: its request, with ``keep_tracks``.
        outputs: output file of each result.
        tracks: tracks to write metrics of; None for all tracks of a result.

    Raises:
        PosetrackError: a result or its ground truth cannot be read, or a file cannot be written.
    """
    names = [one.name for one in found.evaluations]
    kept = {} if found.rows else {(one.path, one.which, one.label): one for one in found.on_page}
    of_path = {one.path: one.name for one in reversed(found.evaluations)}
    for folder in {out.parent for out in outputs.values() if not out.parent.is_dir()}:
        _make_folder(folder)
    for path, out in outputs.items():
        if path not in of_path:
            continue  # unreadable; already reported as a failed gate
        available = read_result(path).tracks
        evaluations = [
            kept.get((path, which, label))
            or evaluate(path, request.options_of(path, which, label), track_name(of_path[path], which, names))
            for label in request.labels_of(path)
            for which in tracks or available
            if which in available
        ]
        yield of_path[path], write_mcap(path, out, evaluations, _record(found, request, path, evaluations))


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise ResultError("cannot be written", where=folder, found=error.strerror or error) from error


def write_mcap(
    source: Path, out: Path, evaluations: Sequence[Evaluation], record: Mapping[str, str]
) -> tuple[Loss, ...]:
    """Write a copy of a result with metrics on ``/eval/<subject>`` and ``/eval/smoothed/<subject>``.

    Channels, messages, attachments and metadata are copied, one chunk at a time. Metrics of an earlier
    evaluation are replaced.

    Args:
        source: the result.
        out: output file, written atomically.
        evaluations: evaluations of its tracks, with ``keep_tracks``.
        record: content of the metadata record ``posetrack.eval``, without the losses.

    Returns:
        The parts of the result that could not be read and are missing in the copy.

    Raises:
        ResultError: the file cannot be written.
    """
    file = McapFile(source)
    with (
        whole_or_nothing(out) as part,
        McapSink(part, chunk_bytes=_CHUNK_BYTES) as sink,
        copied_result(file, sink, _copied, without=[EVAL_RECORD], in_file_order=True),
    ):
        for one in evaluations:
            _write_metrics(sink, one)
        lost = {"losses": json.dumps([asdict(loss) for loss in file.losses.losses])}
        sink.metadata(EVAL_RECORD, {**record, **lost})
    return file.losses.losses


def _copied(schema: Schema | None, channel: Channel) -> Copied | None:
    return None if channel.topic.startswith(EVAL_PREFIX) else unchanged(schema, channel)


def _write_metrics(sink: McapSink, evaluation: Evaluation) -> None:
    """Write a message per estimate, at its stamp."""
    values, track = frame_metrics(evaluation), evaluation.track
    topic = f"{EVAL_PREFIX.rstrip('/')}{topics_prefix(evaluation.topic, evaluation.which)}"
    channel_id = sink.json_channel(topic, METRICS_SCHEMA_NAME, metrics_schema(values))
    for row, stamp_ns in enumerate(track.stamp_ns.tolist()):
        message = {"stamp_ns": stamp_ns, "status": track.status(row).value}
        # JSON has no NaN; missing metrics are left out.
        message |= {name: float(of[row]) for name, of in values.items() if np.isfinite(of[row])}
        sink.write(channel_id, stamp_ns, json.dumps(message, separators=(",", ":")).encode())
        if row % _CHUNK_FRAMES == _CHUNK_FRAMES - 1:
            sink.flush()
    sink.flush()


def frame_metrics(evaluation: Evaluation) -> dict[str, FloatArray]:
    """Return the per-frame metrics of a track (N,) by name, in table order; NaN for missing values.

    Metrics with parts, such as joints, are means over the parts. Metrics without any value are left out.
    """
    every = {**evaluation.placed_series(), **run_series(evaluation.track), **evaluation.track_series}
    return {name: every[name] for name in sorted(every, key=place_of) if np.isfinite(every[name]).any()}


def metrics_schema(names: Iterable[str]) -> dict[str, Any]:
    """Return the JSON schema of messages with these metrics."""
    properties: dict[str, Any] = {
        "stamp_ns": {"type": "integer", "description": "Stamp of the estimate, ns."},
        "status": {"type": "string", "description": "Tracking status of the estimate."},
    }
    properties |= {name: {"type": "number", "description": metric_of(name).meaning} for name in names}
    return {
        "title": METRICS_SCHEMA_NAME,
        "description": "Metrics of a frame, averaged over parts such as joints; missing ones are left out.",
        "type": "object",
        "properties": properties,
        "required": ["stamp_ns", "status"],
        "additionalProperties": False,
    }


def _record(
    found: Assessment, request: Request, path: Path, evaluations: Sequence[Evaluation]
) -> dict[str, str]:
    """Return the metadata: totals as in ``--json``, gates of the result and its pools, ground truth."""
    names = {*(one.name for one in evaluations), *(pool.name for pool in found.pools)}
    values = {
        "options": stated_options(request.options_of(path, evaluations[0].which)),
        "results": [result_values(one) for one in evaluations],
        "gates": [vars(outcome) for outcome in found.outcomes if outcome.result in names],
    }
    stated = {key: json.dumps(finite(value), allow_nan=False) for key, value in values.items()}
    return {"format": FORMAT, "version": version(), **stated, **_truth(path, request, evaluations)}


def _truth(path: Path, request: Request, evaluations: Sequence[Evaluation]) -> dict[str, str]:
    """Return the source of the ground truth: name and SHA-256 of a file, or topics of the result."""
    if not any(one.coverage.has_truth for one in evaluations):
        return {}
    given = request.options_of(path, evaluations[0].which).truth
    if given is None:
        return {"truth.topics": json.dumps(read_result(path).truth_topics)}
    if given.is_dir():
        return {"truth.name": shown_name(given), "truth.kind": "folder"}
    identity = identity_record(given, "file", file_digest(given))
    return {f"truth.{key}": value for key, value in identity.items()}
