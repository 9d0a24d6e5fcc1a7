"""Export of a track as BIDS Motion: a table of channels and its descriptions, in a new or existing dataset.

Channels are latency, confidence, pose and points in axes of the reference camera, and joint angles of a hand;
s, m and deg. Lost frames have n/a.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from posetrack_cli import limits
from posetrack_cli.arrays import FloatArray, IntArray
from posetrack_cli.errors import ResultError, UsageError
from posetrack_cli.files import open_output, read_text
from posetrack_cli.outputs import check_target, make_folder, whole_or_nothing
from posetrack_cli.results.columns import Columns
from posetrack_cli.results.derived import is_tracked, joint_angle_names, joint_angles
from posetrack_cli.results.estimate import Subject
from posetrack_cli.results.export.source import CAMERA_AXES, ExportSource, session_time
from posetrack_cli.results.export.table import SINGLE_HZ
from posetrack_cli.text import one_line
from posetrack_cli.units import METRES_PER_MM, NS_PER_S

ENDING = "_motion.tsv"
VERSION = "1.10.0"
"""Of BIDS; Motion belongs to it since 1.9.0."""
ENTITIES = ("sub", "ses", "task", "tracksys", "acq", "run")
"""Parts of file names, in their order."""
TYPES = ("ACCEL", "ANGACCEL", "GYRO", "JNTANG", "LATENCY", "MAGN", "MISC", "ORNT", "POS", "VEL")
"""Of channels; a sidecar states how many of each there are."""
MISSING = "n/a"
REFERENCE_FRAME = {
    "camera": {
        "SpatialAxes": "RIA",
        "RotationRule": "right-hand",
        "Description": f"origin at the reference camera, {CAMERA_AXES}; SpatialAxes are the camera's",
    }
}


@dataclass(frozen=True)
class Place:
    """Place of a track in a dataset.

    Attributes:
        root: folder of the dataset.
        labels: by entity, in order.
    """

    root: Path
    labels: Mapping[str, str]

    @classmethod
    def of(cls, out: Path, subject: Subject) -> Place:
        """Read the place from an output: DATASET/sub-01_task-reach, or the whole path of a motion file.

        Raises:
            UsageError: the name does not have this form.
        """
        given = dict(re.findall(r"(?:^|_)([a-z]+)-([0-9A-Za-z]+)(?=_|$)", out.name.removesuffix(ENDING)))
        written = "_".join(f"{key}-{given[key]}" for key in ENTITIES if key in given)
        complete = {"sub", "task"} <= given.keys() and given.get("run", "1").isdigit()
        if written != out.name.removesuffix(ENDING) or not complete:
            expected = "DATASET/sub-01_task-reach, optionally with ses, tracksys, acq and run"
            raise UsageError("not a name of BIDS", where=out, found=out.name, expected=expected)
        given.setdefault("tracksys", re.sub("[^0-9A-Za-z]", "", subject.frame) or "posetrack")
        place = cls(out.parent, {key: given[key] for key in ENTITIES if key in given})
        inside = place.folder.relative_to(out.parent).parts
        return (
            cls(out.parents[len(inside)], place.labels)
            if out.parent.parts[-len(inside) :] == inside
            else place
        )

    @property
    def prefix(self) -> str:
        """Subject and session, as in names of tables that belong to them."""
        return "_".join(f"{key}-{self.labels[key]}" for key in ("sub", "ses") if key in self.labels)

    @property
    def folder(self) -> Path:
        """Folder of the motion file."""
        return self.root.joinpath(*self.prefix.split("_"), "motion")

    def file(self, ending: str) -> Path:
        """Return a file of the track, such as ``motion.tsv``."""
        return self.folder / "_".join((*(f"{key}-{label}" for key, label in self.labels.items()), ending))


class Channel(NamedTuple):
    """Column of a motion file: its row in the table of channels, and its values (N,)."""

    name: str
    component: str
    type: str
    tracked_point: str
    units: str
    reference_frame: str
    values: FloatArray


def write_bids(source: ExportSource, out: Path, *, overwrite: bool = False) -> Path:
    """Write a track into a dataset; create the files of a dataset that are missing.

    Args:
        source: the track.
        out: see ``Place.of``.
        overwrite: replace the files of this track.

    Returns:
        The motion file.

    Raises:
        UsageError: the name does not follow BIDS, or the motion file exists.
        ResultError: there are no estimates, or a file cannot be read or written.
    """
    place = Place.of(out, source.result.subject)
    columns = source.columns()
    if not len(columns["stamp_ns"]):
        raise ResultError("has no estimates", where=source.where)
    start, seconds = session_time(source, columns["stamp_ns"])
    channels = list(_channels(columns, source.result.subject, seconds - seconds.min()))
    motion = place.file("motion.tsv")
    try:
        make_folder(place.folder, place.root if place.root.is_dir() else place.root.parent)
        check_target(motion, overwrite=overwrite, source=source.result.path, source_name="result")
        _complete_dataset(place, source)
        if start is not None:
            date = (start + timedelta(seconds=float(seconds.min()))).isoformat().replace("+00:00", "Z")
            row = {"filename": f"motion/{motion.name}", "acq_time": date}
            _add_row(place.folder.parent / f"{place.prefix}_scans.tsv", row)
        described = (channel[:-1] for channel in channels)
        _write(place.file("channels.tsv"), _tsv([Channel._fields[:-1], *described]))
        _write(place.file("channels.json"), [_json({"reference_frame": {"Levels": REFERENCE_FRAME}})])
        _write(place.file("motion.json"), [_json(_sidecar(place, source, channels, columns["stamp_ns"]))])
        _write(motion, _tsv(zip(*(_cells(channel.values) for channel in channels), strict=True)))
    except OSError as error:
        raise ResultError("cannot be written", where=place.root, found=error.strerror or error) from error
    return motion


def _channels(columns: Columns, subject: Subject, latency: FloatArray) -> Iterator[Channel]:
    """Yield the channels; all but latency and confidence are NaN where lost."""
    lost = ~is_tracked(columns)[:, None]
    points = np.concatenate([columns["position"][:, None], columns["points"]], axis=1)
    places = np.where(lost[..., None], np.nan, METRES_PER_MM * points)
    yield Channel("latency", MISSING, "LATENCY", MISSING, "s", MISSING, latency)
    yield Channel("confidence", MISSING, "MISC", subject.name, MISSING, MISSING, columns["confidence"])
    for name, place in zip((subject.name, *subject.point_names), np.moveaxis(places, 1, 0), strict=True):
        for axis, values in zip("xyz", place.T, strict=True):
            yield Channel(f"{name}_{axis}", axis, "POS", name, "m", "camera", values)
    turns = np.where(lost, np.nan, columns["quaternion"])
    for axis, values in zip("xyzw", turns.T, strict=True):
        part = f"quat_{axis}"
        yield Channel(f"{subject.name}_{part}", part, "ORNT", subject.name, MISSING, "camera", values)
    if names := joint_angle_names(subject):
        angles = np.where(lost, np.nan, joint_angles(columns, subject))
        for name, values in zip(names, angles.T, strict=True):
            joint = name.rpartition("_")[0]
            yield Channel(name, MISSING, "JNTANG", joint, "deg", MISSING, values)


def _sidecar(
    place: Place, source: ExportSource, channels: Sequence[Channel], stamps_ns: IntArray
) -> dict[str, Any]:
    """Return the content of ``*_motion.json``."""
    run, steps = source.result.run, np.diff(stamps_ns) / NS_PER_S
    steps = steps[steps > 0.0]
    counts = {kind: sum(channel.type == kind for channel in channels) for kind in TYPES}
    return {
        "TaskName": place.labels["task"],
        "SamplingFrequency": float(1.0 / np.median(steps)) if len(steps) else SINGLE_HZ,
        "SamplingFrequencyEffective": float(1.0 / np.mean(steps)) if len(steps) else MISSING,
        "RecordingDuration": float(np.sum(steps)),
        "TrackingSystemName": f"posetrack {run.get('tracker', '')}".strip(),
        "SoftwareVersions": run.get("version", MISSING),
        "MissingValues": MISSING,
        "MotionChannelCount": len(channels),
        "TrackedPointsCount": len({channel.tracked_point for channel in channels if channel.type == "POS"}),
        **{f"{kind}ChannelCount": count for kind, count in counts.items()},
    }


def _complete_dataset(place: Place, source: ExportSource) -> None:
    """Write the description of the dataset, a readme and the participant, if they are missing."""
    description = place.root / "dataset_description.json"
    if not description.exists():
        by = {"Name": "posetrack", "Version": source.result.run.get("version", MISSING)}
        name = place.root.absolute().name
        values = {"Name": name, "BIDSVersion": VERSION, "DatasetType": "raw", "GeneratedBy": [by]}
        _write(description, [_json(values)])
    if not any(place.root.glob("README*")):
        _write(
            place.root / "README.md",
            ["Motion of hands and heads, tracked by posetrack in recorded images.\n"],
        )
    _add_row(place.root / "participants.tsv", {"participant_id": f"sub-{place.labels['sub']}"})


def _add_row(path: Path, row: Mapping[str, str]) -> None:
    """Add a row to a table, or set its cells in the row that begins with the same one."""
    try:
        lines = read_text(path, limits.TEXT_BYTES).splitlines() if path.exists() else []
    except UnicodeDecodeError as error:
        raise ResultError("is not UTF-8", where=path, found=error.reason) from error
    header, *rows = [line.split("\t") for line in lines if line] or [list(row)]
    header += [name for name in row if name not in header]
    by_key = {cells[0]: dict(zip(header, cells, strict=False)) for cells in rows}
    key = row[header[0]] if header[0] in row else next(iter(row.values()))
    by_key.setdefault(key, {}).update(row)
    table = [header, *([cells.get(name, MISSING) for name in header] for cells in by_key.values())]
    if "\n".join("\t".join(cells) for cells in table) != "\n".join(lines):
        _write(path, _tsv(table))


def _cells(values: FloatArray) -> list[object]:
    return [MISSING if value != value else value for value in values.tolist()]


def _tsv(rows: Iterable[Iterable[object]]) -> Iterator[str]:
    for row in rows:
        yield (
            "\t".join(
                one_line(cell).replace("\t", " ") if isinstance(cell, str) else repr(cell) for cell in row
            )
            + "\n"
        )


def _json(values: Mapping[str, Any]) -> str:
    return json.dumps(values, indent=2, ensure_ascii=True) + "\n"


def _write(path: Path, pieces: Iterable[str]) -> None:
    with whole_or_nothing(path) as part, open_output(part) as stream:
        for piece in pieces:
            stream.write(piece.encode())
