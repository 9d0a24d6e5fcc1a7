"""Recording and hand model of a result, found from its run record."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePath
from tempfile import TemporaryDirectory
from typing import Any

from posetrack_cli.configuration import validated
from posetrack_cli.errors import PosetrackError, RecordingError, ResultError, UsageError
from posetrack_cli.files import placed_path, real_path
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.config import HandConfig, HandSettings
from posetrack_cli.hand.model.anatomy import HandAnatomy, make_anatomy, reshaped_anatomy
from posetrack_cli.hand.model.hand import MESH_DIGEST, HandModel, hand_model
from posetrack_cli.recording.base import (
    CAMERA_FILE_KEY,
    CAMERA_FILE_NAME,
    PATH_KEY,
    RECORDING_KEY,
    NotCalibratedError,
)
from posetrack_cli.recording.camera_file import camera_file_text
from posetrack_cli.recording.camera_of import Guess
from posetrack_cli.recording.camera_record import camera_from_json
from posetrack_cli.recording.identity import file_digest
from posetrack_cli.recording.pixels import PixelKind
from posetrack_cli.recording.recording import Recording
from posetrack_cli.results.estimate import kind_of
from posetrack_cli.results.reader import Result

# Search for the recording by path or name; it is identified by its SHA-256


SHOWN_DIGITS = 12
MOST_PARTS = 32
"""Maximum number of trailing path components that are searched for, as run records are untrusted."""
FOLDER_KINDS = ("folder", "ros2")
ANY_HINT = "pass the recording of the run with its options, or use posetrack view --any-recording"


def check_kind(path: Path, run: Mapping[str, str]) -> None:
    """Check that a path is a file or a folder, like the input of the run.

    Raises:
        RecordingError: it is of the other kind.
    """
    kinds = {True: "a folder", False: "a file"}
    is_folder, was_folder = path.is_dir(), run.get("input.kind") in FOLDER_KINDS
    if path.exists() and run.get("input.kind") and is_folder != was_folder:
        raise another(path, run, kinds[is_folder], kinds[was_folder])


def check_bytes(path: Path, run: Mapping[str, str]) -> None:
    """Check the SHA-256 of a file, even if it cannot be opened as a recording.

    Raises:
        RecordingError: the file differs from the input of the run.
    """
    stated = run.get(RECORDING_KEY, "")
    if not stated or not path.is_file():
        return
    _, digest = file_digest(path)
    if digest != stated:
        raise another(path, run, f"SHA-256 {digest[:SHOWN_DIGITS]}", stated[:SHOWN_DIGITS])


def check_size(path: Path, run: Mapping[str, str]) -> None:
    """Check the size of a file, which is faster than its digest.

    Raises:
        RecordingError: the file differs from the input of the run.
    """
    stated = run.get("input.bytes", "")
    if not stated or not path.is_file():
        return
    size = path.stat().st_size
    if str(size) != stated:
        raise another(path, run, f"{size} bytes", f"{stated} bytes")


def check_identity(recording: Recording, run: Mapping[str, str]) -> None:
    """Check the SHA-256 and the topic of a recording.

    Raises:
        RecordingError: they differ from those of the run.
    """
    stated = run.get(RECORDING_KEY, "")
    if not stated:
        return  # the input of the run had no identity
    found = recording.identity()
    # The size is also reported, as it often shows at a glance that a file was cut or converted.
    if found["sha256"] != stated:
        size = f" ({found['bytes']} bytes)", f" ({run.get('input.bytes', 'unknown')} bytes)"
        digests = f"{found['sha256'][:SHOWN_DIGITS]}{size[0]}", f"{stated[:SHOWN_DIGITS]}{size[1]}"
        raise another(recording.path, run, f"SHA-256 {digests[0]}", digests[1])
    if found.get("topic") != run.get("input.topic"):
        raise another(recording.path, run, f"topic {found.get('topic', 'none')}", run.get("input.topic", ""))


def another(path: Path, run: Mapping[str, str], found: str, expected: str) -> RecordingError:
    """Return the error for a recording that is not the input of the run."""
    name = run.get("input.name", "the run's input")
    return RecordingError(
        "not the recording of the result",
        where=path,
        found=found,
        expected=f"{expected} of {name}",
        hint=ANY_HINT,
    )


MEANT = ("fps", "mirror")
"""Options that change stamps or images; they must not differ from those of the run."""
WITHOUT_CAMERA = (*MEANT, "depth_unit_mm", "missing")
"""Options of the run that apply if the recording has no calibration."""


def _truth(text: str) -> bool:
    return text == "true"


_STATED: Mapping[str, Callable[[str], Any]] = {
    "topic": str,
    "camera_topic": str,
    "cameras": lambda text: text.split(","),
    "fps": float,
    "depth_unit_mm": float,
    "missing": int,
    "mirror": _truth,
    "tolerance_ms": float,
}
"""Parsers of the options that a run record stores as ``input.NAME``."""


@dataclass(frozen=True)
class Search:
    """Result of a search for a recording.

    Attributes:
        recording: the recording; None if it was not found.
        reason: why it was not found, with the searched places.
    """

    recording: Recording | None
    reason: str = ""


def search_recording(
    result: Result,
    given: Path | None = None,
    *,
    any_recording: bool = False,
    in_colour: bool = False,
    **opening: Any,
) -> Search:
    """Search for the recording of a result.

    A run record stores path, size and SHA-256 of its input. Without ``given``, the recording is searched at
    that path, then by the last components of the path in the folders of ``folders_of`` and all parents of the
    result, so that recordings and results can be moved together. The SHA-256 must match.

    Args:
        result: the result; its run record also states how the recording was opened.
        given: the file or folder to use.
        any_recording: use ``given`` even if it is another recording; rate and cameras default to the run's.
        in_colour: keep colour images, for drawing, even if grey images were tracked.
        opening: options of ``open_recording`` that override those of the run.

    Raises:
        RecordingError: ``given`` cannot be read, or is another recording.
        UsageError: an option does not apply to ``given``, or contradicts the run.
    """
    if in_colour and pixels_of(result) == "grey":
        opening = {**opening, "in_colour": True}
    if given is None:
        return _found_beside(result, opening)
    if any_recording:
        return Search(_another(given, result, opening))
    return Search(_same(given, result, opening))


def _found_beside(result: Result, opening: Mapping[str, Any]) -> Search:
    """Search for the recording at the path in the run record and near the result."""
    run = result.run
    stated = run.get(PATH_KEY) or run.get("input.name", "")
    if Path(stated).name in ("", "..") or not run.get(RECORDING_KEY):  # could not be verified
        return Search(None, f"{result.path} does not state its recording")
    reasons = []
    for place in _places(result, stated):
        try:
            return Search(_same(place, result, opening))
        except RecordingError as error:
            reasons.append(str(error))
    where = f"at {stated}, next to {result.path}, in a parent folder or in the working directory"
    not_found = f"recording '{Path(stated).name}' not found {where}; pass it with --recording"
    return Search(None, "; ".join(reasons) or not_found)


def required_recording(result: Result, given: Path | None = None, **options: Any) -> Recording:
    """Return the recording of a result; see ``search_recording``.

    Raises:
        RecordingError: the recording is not found.
    """
    search = search_recording(result, given, **options)
    if search.recording is None:
        raise RecordingError(search.reason)
    return search.recording


def pixels_of(result: Result) -> PixelKind:
    """Return the kind of images of a result, from its run record or its subject."""
    # Run records do not state the kind of images; it follows from the options of the input.
    if "input.cameras" in result.run:
        return "grey"
    if {"input.topic", "input.depth_unit_mm"} & result.run.keys():
        return "depth"
    return kind_of(result.subjects[0].name).pixels


def folders_of(result: Result) -> Iterator[Path]:
    """Yield the folders to search for files of a result: its folder, the parent, the working directory."""
    folder = result.path.parent
    above = placed_path(folder).parent, real_path(folder).parent  # they differ if the folder is a link
    yield from (folder, *dict.fromkeys(above), Path())


def places_of(stated: str, folders: Iterable[Path]) -> Iterator[Path]:
    """Yield the candidates for a stored path: its last component, its last two, ... in each folder."""
    path = PurePath(stated)
    parts = [part for part in path.parts if part not in (path.anchor, "..")][-MOST_PARTS:]
    for folder in folders:
        for first in reversed(range(len(parts))):
            yield folder.joinpath(*parts[first:])


def _places(result: Result, stated: str) -> Iterator[Path]:
    """Yield the existing candidates for the recording, without duplicates and without the result."""
    seen = {real_path(result.path)}
    folders = (*folders_of(result), *placed_path(result.path).parents)
    for place in (Path(stated), *places_of(stated, folders)):
        if os.path.exists(place) and (real := real_path(place)) not in seen:  # noqa: PTH110 never raises
            seen.add(real)
            yield place


def _same(path: Path, result: Result, opening: Mapping[str, Any]) -> Recording:
    """Open a recording with the options of the run; raise RecordingError if it is another one."""
    from posetrack_cli.recording.opening import open_recording, options_for

    run = result.run
    check_kind(path, run)
    check_size(path, run)
    given = {key: value for key, value in opening.items() if value is not None}
    stated, usable = _options_of(run), options_for(path, pixels_of(result))
    options = {key: value for key, value in stated.items() if key in usable}  # some only apply to depth
    _check_given(options, given)
    if "camera_file" in given:
        options.pop("camera_topic", None)
        if run.get("input.kind") == "video":
            options.pop("cameras", None)  # the camera of a video is named by the camera file
    with _camera_file(result, given) as camera:
        try:
            recording = open_recording(path, pixels_of(result), **(options | camera | given))
        except RecordingError:
            check_bytes(path, run)  # report a changed file rather than the error that this causes
            raise
        if recording.is_guessed:
            recording = recording.with_camera(camera_of(run))
        check_identity(recording, run)  # with the camera file, which is part of a folder's identity
    return recording


def _another(path: Path, result: Result, opening: Mapping[str, Any]) -> Recording:
    """Open any recording; if it has no calibration, use the cameras of the run."""
    from posetrack_cli.recording.opening import open_recording, options_for

    pixels, run = pixels_of(result), _options_of(result.run)
    usable = options_for(path, pixels) & run.keys()
    given = {key: value for key, value in opening.items() if value is not None}
    try:
        return open_recording(path, pixels, **({key: run[key] for key in usable.intersection(MEANT)} | given))
    except NotCalibratedError:
        if "camera_file" in given:
            raise
    options = {key: run[key] for key in usable.intersection(WITHOUT_CAMERA)}
    with _written(_camera_text(result)) as file:
        try:
            return open_recording(path, pixels, **({"camera_file": file} | options | given))
        except RecordingError as error:  # the message names the temporary camera file
            words = str(error).replace(str(file), CAMERA_FILE_NAME).removeprefix(f"{CAMERA_FILE_NAME}: ")
            raise RecordingError(words, where=f"{path}, with the run's camera") from error


def _options_of(run: Mapping[str, str]) -> dict[str, Any]:
    """Return the options with which the run opened its input."""
    stated = {key: run.get(f"input.{key}", "") for key in _STATED}
    try:
        options = {key: _STATED[key](text) for key, text in stated.items() if text}
    except ValueError as error:
        raise ResultError("run record cannot be read", found=error) from error
    if run.get("input.topics") and run.get("input.calibration") != "camera file":
        options["cameras"] = run["input.topics"].split(",")  # by topic, as frame names can be ambiguous
    if run.get("intrinsics") in ("guessed", "estimated"):
        options["guess"] = Guess()
    return options


def _check_given(options: Mapping[str, Any], given: Mapping[str, Any]) -> None:
    """Raise an error if an option that changes stamps or images differs from the run."""
    for name in MEANT:
        run, asked = options.get(name), given.get(name)
        if run is not None and asked is not None and run != asked:
            found, expected = _readable(asked), _readable(run)
            what = f"--{name} differs from the run"
            raise UsageError(what, found=found, expected=expected, hint="omit the option")


def _readable(value: float | bool) -> str:
    return ("yes" if value else "no") if isinstance(value, bool) else f"{value:g}"


@contextmanager
def _camera_file(result: Result, given: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """Provide the camera file of the run, unless another calibration is given."""
    if f"input.{CAMERA_FILE_KEY}" not in result.run or {"camera_file", "camera_topic"} & given.keys():
        yield {}
        return
    with _written(_camera_text(result)) as file:
        yield {"camera_file": file}


@contextmanager
def _written(text: str) -> Iterator[Path]:
    """Provide a temporary camera file with this text."""
    with TemporaryDirectory() as folder:
        file = Path(folder) / CAMERA_FILE_NAME
        file.write_bytes(text.encode("utf-8", "backslashreplace"))
        yield file


def _camera_text(result: Result) -> str:
    """Return the camera file of a run, or its cameras in the format of a camera file."""
    run = result.run
    if f"input.{CAMERA_FILE_KEY}" in run:
        return run[f"input.{CAMERA_FILE_KEY}"]
    mirrored = run.get("input.mirror") == "true"
    known = result.several_cameras or (camera_of(run),)
    cameras = [camera.mirrored() if mirrored else camera for camera in known]
    return camera_file_text(cameras) if len(cameras) > 1 else _lone_camera_text(cameras[0])


def _lone_camera_text(camera: Camera) -> str:
    """Return the text of a camera file with a single, unnamed camera."""
    values = {key: value for key, value in camera.values().items() if key != "name"}
    return "".join(f"{key} = {json.dumps(value)}\n" for key, value in values.items())


def camera_of(run: Mapping[str, str]) -> Camera:
    """Return the camera whose frame the estimates of a run are in.

    Raises:
        ResultError: the run record has no valid camera.
    """
    try:
        return camera_from_json(run["camera"])
    except (KeyError, ValueError, PosetrackError) as error:
        raise ResultError("run record has no valid camera", found=error) from error


def cameras_of(result: Result, recording: Recording) -> tuple[Camera, ...]:
    """Return the cameras of a result.

    Raises:
        UsageError: the image size of the recording differs.
    """
    cameras = result.cameras()
    sizes = [[(camera.width, camera.height) for camera in of] for of in (recording.cameras, cameras)]
    if sizes[0] != sizes[1]:
        found, expected = (", ".join(f"{w}x{h}" for w, h in of) for of in sizes)
        raise UsageError(
            "image size differs from that of the run",
            where=recording.path,
            found=found,
            expected=expected,
            hint="pass the --camera of the run, which may crop the images",
        )
    return cameras


# The tracked hand


def hand_of(result: Result) -> HandModel:
    """Return the hand model of a run, from the configuration in its record.

    A hand file is searched by the end of the stored path next to the result, in the parent folder, and in the
    working directory. As results are untrusted, no other place is searched, and the digest must match.

    Raises:
        ResultError: the record has no configuration of a hand run, or the hand file is not found.
        UsageError: the hand file is invalid.
    """
    settings = _settings(result)
    if settings.mesh is not None:
        settings = settings.model_copy(update={"mesh": str(_found_mesh(result, settings.mesh))})
    return hand_model(settings)


def anatomy_of(result: Result) -> HandAnatomy:
    """Return the hand anatomy of a run, faster than ``hand_of``, which also builds the skin.

    Raises:
        ResultError, UsageError: as for ``hand_of``.
    """
    settings = _settings(result)
    right = make_anatomy() if settings.mesh is None else _anatomy_of_file(_found_mesh(result, settings.mesh))
    return reshaped_anatomy(right, "left" if settings.side == "left" else "right", settings.shape)


def _anatomy_of_file(path: Path) -> HandAnatomy:
    from posetrack_cli.hand.model.webxr import load_hand  # slow import, rarely needed

    return load_hand(path).anatomy


def _settings(result: Result) -> HandSettings:
    try:
        stated: Any = json.loads(result.run["configuration"])["hand"]
        if result.subject.label in ("left", "right"):
            stated = {**stated, "side": result.subject.label}
        return validated(HandSettings, stated, "run record")
    except (KeyError, TypeError, ValueError, RecursionError, UsageError) as error:
        what = "run record has no hand configuration"
        expected = "the record of a hand run"
        raise ResultError(what, where=result.path, found=error, expected=expected) from error


def _found_mesh(result: Result, stated: str) -> Path:
    files = [path for path in places_of(stated, folders_of(result)) if os.path.isfile(path)]  # noqa: PTH113 never raises
    for path in files:
        if file_digest(path)[1] == result.run.get(MESH_DIGEST):
            return path
    if files:
        raise ResultError("hand file has changed since the run", where=files[0])
    raise ResultError(
        "hand file of the run not found",
        where=result.path,
        found=f"no {PurePath(stated).name} next to the result or in the working directory",
        hint="copy the file there",
    )


def configuration_of(run: Mapping[str, str]) -> HandConfig:
    """Return the configuration of a hand run, from its record.

    Raises:
        ResultError: the record has none.
    """
    try:
        return validated(HandConfig, json.loads(run["configuration"]), "run record")
    except (KeyError, TypeError, ValueError, UsageError) as error:
        what = "run record has no hand configuration"
        raise ResultError(what, found=error, expected="the record of a hand run") from error
