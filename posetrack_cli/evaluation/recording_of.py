"""The recording that a result was made from: found by its name, known by its SHA-256."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeVar

from posetrack_cli.errors import PosetrackError, RecordingError, ResultError, UsageError
from posetrack_cli.evaluation.recording_identity import check_bytes, check_identity, check_kind, check_size
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.recording.camera_file import CAMERA_FILE_NAME
from posetrack_cli.recording.opening import open_recording
from posetrack_cli.recording.recording import Recording
from posetrack_cli.results.camera_record import camera_from_json
from posetrack_cli.results.reader import Result

Found = TypeVar("Found")

MEANT = ("fps", "mirror")
"""Options that a folder of images is read with, and that frames and estimates depend on."""


@dataclass(frozen=True)
class Search:
    """What came of looking for a recording.

    Attributes:
        recording: None where there is none.
        reason: why there is none: where it was looked for, and what was wrong with what was there.
    """

    recording: Recording | None
    reason: str = ""


def search_recording(
    result: Result, given: Path | None = None, *, any_recording: bool = False, **opening: Any
) -> Search:
    """Look for the recording that a result was made from.

    A result states its input's name, size and SHA-256, no path. Without ``given`` the name is looked for
    beside the result, in the folder above and in the working folder; one that differs is not taken.

    Args:
        result: its run record says what to look for, and how it was opened.
        given: the file or folder to take.
        any_recording: take ``given`` whatever it is, opened with ``opening`` alone.
        opening: options of ``open_recording`` that replace those of the run.

    Raises:
        RecordingError: ``given`` cannot be read, or is another recording.
        UsageError: an option that does not apply to ``given``, or is not that of the run.
    """
    if given is not None:
        recording = open_recording(given, **opening) if any_recording else _same(given, result, opening)
        return Search(recording)
    return Search(*found_beside(result, lambda place: _same(place, result, opening)))


def found_beside(result: Result, opened: Callable[[Path], Found]) -> tuple[Found | None, str]:
    """Return the recording by the name that a result states, None and why where there is none.

    Args:
        result: beside which it is looked for, one folder up and in the working folder.
        opened: opens what is there as the run did; RecordingError if it is another.
    """
    name = Path(result.run.get("input.name", "")).name
    if name in ("", ".."):
        return None, f"{result.path} does not say which recording it was made from"
    reasons = []
    for place in _places(result, name):
        try:
            return opened(place), ""
        except RecordingError as error:
            reasons.append(str(error))
    looked = ", ".join(dict.fromkeys(str(folder) for folder in folders_of(result)))
    nowhere = f"no recording '{name}' in {looked}; pass it with --recording"
    return None, "; ".join(reasons) or nowhere


def required_recording(result: Result, given: Path | None = None, **options: Any) -> Recording:
    """As ``search_recording``, but not to find one is an error.

    Raises:
        RecordingError: there is none; says where it was looked for.
    """
    search = search_recording(result, given, **options)
    if search.recording is None:
        raise RecordingError(search.reason)
    return search.recording


def folders_of(result: Result) -> Iterator[Path]:
    """Yield where files that a result names are looked for: beside it, one folder up, the working folder."""
    beside = result.path.parent
    yield from (beside, beside.resolve().parent, Path())


def _places(result: Result, name: str) -> Iterator[Path]:
    """What bears the name, each once."""
    places = (folder / name for folder in folders_of(result))
    yield from {place.resolve(): place for place in places if place.exists()}.values()


def _same(path: Path, result: Result, opening: Mapping[str, Any]) -> Recording:
    """Open a recording as the run did; raise RecordingError if it is not the one of the run."""
    run = result.run
    check_kind(path, run)
    check_size(path, run)
    given = {key: value for key, value in opening.items() if value is not None}
    options = _options_of(run)
    _check_given(options, given)
    if "camera_file" in given:
        options.pop("camera_topic", None)
    options |= given
    with _camera_of(path, run, options) as camera:
        try:
            recording = open_recording(path, **options, **camera)
        except RecordingError:
            check_bytes(path, run)  # a file that was changed may lack what the run found in it
            raise
    check_identity(recording, run)
    return recording


def _options_of(run: Mapping[str, str]) -> dict[str, Any]:
    """How the run opened its input, as far as it says."""
    read: dict[str, Callable[[str], Any]]
    if run.get("input.kind") == "folder":
        read = {"fps": float, "depth_unit_mm": float, "missing": int, "mirror": _truth}
    else:
        read = {"topic": str, "camera_topic": str, "mirror": _truth}
    try:
        found = {key: convert(run[f"input.{key}"]) for key, convert in read.items() if f"input.{key}" in run}
    except ValueError as error:
        raise ResultError("run record cannot be read", found=error) from error
    return {key: value for key, value in found.items() if value != ""}


def _truth(text: str) -> bool:
    return text == "true"


def _check_given(options: Mapping[str, Any], given: Mapping[str, Any]) -> None:
    """Frames are matched by their stamps, which a rate makes; the hand is drawn where it was tracked."""
    for name in MEANT:
        run, asked = options.get(name), given.get(name)
        if run is not None and asked is not None and run != asked:
            found, expected = _readable(asked), _readable(run)
            what = f"--{name} is not that of the run"
            raise UsageError(what, found=found, expected=expected, hint="leave it out")


def _readable(value: float | bool) -> str:
    return ("yes" if value else "no") if isinstance(value, bool) else f"{value:g}"


@contextmanager
def _camera_of(path: Path, run: Mapping[str, str], options: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """The run's camera, for an MCAP file that was tracked with a camera file and none is given now."""
    with_file = run.get("input.kind") == "mcap" and run.get("input.camera_topic") == ""
    if not with_file or path.is_dir() or {"camera_file", "camera_topic"} & options.keys():
        yield {}
        return
    camera = camera_of(run)
    stored = camera.mirrored() if options.get("mirror") else camera
    with TemporaryDirectory() as folder:
        file = Path(folder) / CAMERA_FILE_NAME
        values = {key: value for key, value in stored.values().items() if key != "name"}
        file.write_text("".join(f"{key} = {json.dumps(value)}\n" for key, value in values.items()))
        yield {"camera_file": file}


def camera_of(run: Mapping[str, str]) -> Camera:
    """The camera that a run's estimates are relative to.

    Raises:
        ResultError: the run record does not tell it.
    """
    try:
        return camera_from_json(run["camera"])
    except (KeyError, ValueError, PosetrackError) as error:
        raise ResultError("run record tells no camera", found=error) from error


def check_same_size(camera: Camera, recording: Recording) -> None:
    """Refuse images that the run's camera cannot have taken.

    Raises:
        UsageError: they are of another size.
    """
    given = recording.cameras[0]
    if (given.width, given.height) != (camera.width, camera.height):
        raise UsageError(
            "images are not of the size that was tracked",
            where=recording.path,
            found=f"{given.width}x{given.height}",
            expected=f"{camera.width}x{camera.height}",
            hint="pass the --camera of the run, whose crop applies",
        )
