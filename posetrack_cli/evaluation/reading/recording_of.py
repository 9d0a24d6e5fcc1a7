"""The recording that a result was made from, and the hand that it shows."""

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
from posetrack_cli.recording.camera_of import guess_of_camera
from posetrack_cli.recording.identity import file_digest
from posetrack_cli.recording.opening import open_recording, options_for
from posetrack_cli.recording.pixels import PixelKind
from posetrack_cli.recording.recording import Recording
from posetrack_cli.results.estimate import kind_of
from posetrack_cli.results.reader import Result
from posetrack_cli.results.records import camera_from_json

# The recording that a result was made from: found by its path or name, known by its SHA-256


SHOWN_DIGITS = 12
MOST_PARTS = 32
"""Of a stated path, from its end, are looked for: a stranger's may have any number."""
FOLDER_KINDS = ("folder", "ros2")
ANY_HINT = "pass the recording of the run with its options; posetrack view --any-recording draws on any"


def check_kind(path: Path, run: Mapping[str, str]) -> None:
    """Tell a folder from a file, whose options are others.

    Raises:
        RecordingError: the run's input was of the other kind.
    """
    kinds = {True: "a folder", False: "a file"}
    is_folder, was_folder = path.is_dir(), run.get("input.kind") in FOLDER_KINDS
    if path.exists() and run.get("input.kind") and is_folder != was_folder:
        raise another(path, run, kinds[is_folder], kinds[was_folder])


def check_bytes(path: Path, run: Mapping[str, str]) -> None:
    """Tell another file by its SHA-256, whether or not it can be opened.

    Raises:
        RecordingError: it is another.
    """
    stated = run.get(RECORDING_KEY, "")
    if not stated or not path.is_file():
        return
    _, digest = file_digest(path)
    if digest != stated:
        raise another(path, run, f"SHA-256 {digest[:SHOWN_DIGITS]}", stated[:SHOWN_DIGITS])


def check_size(path: Path, run: Mapping[str, str]) -> None:
    """Tell another file by its size, before all of it is read.

    Raises:
        RecordingError: it is another.
    """
    stated = run.get("input.bytes", "")
    if not stated or not path.is_file():
        return
    size = path.stat().st_size
    if str(size) != stated:
        raise another(path, run, f"{size} bytes", f"{stated} bytes")


def check_identity(recording: Recording, run: Mapping[str, str]) -> None:
    """Tell another recording by its SHA-256, and another topic of the same.

    Raises:
        RecordingError: it is another.
    """
    stated = run.get(RECORDING_KEY, "")
    if not stated:
        return  # made from something that has no identity
    found = recording.identity()
    if found["sha256"] != stated:
        size = f" ({found['bytes']} bytes)", f" ({run.get('input.bytes', 'unknown')} bytes)"
        digests = f"{found['sha256'][:SHOWN_DIGITS]}{size[0]}", f"{stated[:SHOWN_DIGITS]}{size[1]}"
        raise another(recording.path, run, f"SHA-256 {digests[0]}", digests[1])
    if found.get("topic") != run.get("input.topic"):
        raise another(recording.path, run, f"topic {found.get('topic', 'none')}", run.get("input.topic", ""))


def another(path: Path, run: Mapping[str, str], found: str, expected: str) -> RecordingError:
    """The error about a recording that is not the run's."""
    name = run.get("input.name", "the run's input")
    return RecordingError(
        "is not the recording that the result was made from",
        where=path,
        found=found,
        expected=f"{expected} as of {name}",
        hint=ANY_HINT,
    )


MEANT = ("fps", "mirror")
"""Options that frames and estimates depend on: those of the run must not be replaced by others."""
WITHOUT_CAMERA = (*MEANT, "depth_unit_mm", "missing")
"""And those that a camera file would tell."""


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
"""Options that a run record states as ``input.NAME``, if they apply to the input, and how they are read."""


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
    result: Result,
    given: Path | None = None,
    *,
    any_recording: bool = False,
    in_colour: bool = False,
    **opening: Any,
) -> Search:
    """Look for the recording that a result was made from.

    A result states its input's path as it was typed, size and SHA-256. Without ``given`` it is looked for at
    that path, then by the path's last parts in the folders of ``folders_of`` and all above the result:
    recordings and results may move together. The result itself, and what has another SHA-256, is not taken.

    Args:
        result: its run record says what to look for, and how it was opened.
        given: the file or folder to take.
        any_recording: take ``given`` whatever it is; what it does not tell of rate and cameras is the run's.
        in_colour: colour stays colour where grey was tracked in: to draw on.
        opening: options of ``open_recording`` that replace those of the run.

    Raises:
        RecordingError: ``given`` cannot be read, or is another recording.
        UsageError: an option that does not apply to ``given``, or is not that of the run.
    """
    if in_colour and pixels_of(result) == "grey":
        opening = {**opening, "in_colour": True}
    if given is None:
        return _found_beside(result, opening)
    if any_recording:
        return Search(_another(given, result, opening))
    return Search(_same(given, result, opening))


def _found_beside(result: Result, opening: Mapping[str, Any]) -> Search:
    """Return what lies where a result states, if it is what the run was made from."""
    run = result.run
    stated = run.get(PATH_KEY) or run.get("input.name", "")
    if Path(stated).name in ("", "..") or not run.get(RECORDING_KEY):  # nothing would tell another from it
        return Search(None, f"{result.path} does not say which recording it was made from")
    reasons = []
    for place in _places(result, stated):
        try:
            return Search(_same(place, result, opening))
        except RecordingError as error:
            reasons.append(str(error))
    where = f"at {stated}, beside {result.path}, in a folder above it or in the working folder"
    nowhere = f"no recording '{Path(stated).name}' {where}; pass it with --recording"
    return Search(None, "; ".join(reasons) or nowhere)


def required_recording(result: Result, given: Path | None = None, **options: Any) -> Recording:
    """As ``search_recording``, but not to find one is an error.

    Raises:
        RecordingError: there is none; says where it was looked for.
    """
    search = search_recording(result, given, **options)
    if search.recording is None:
        raise RecordingError(search.reason)
    return search.recording


def pixels_of(result: Result) -> PixelKind:
    """Return what images a result was made from: as its run record states, else as usual for its subject."""
    if "input.cameras" in result.run:
        return "grey"
    if {"input.topic", "input.depth_unit_mm"} & result.run.keys():
        return "depth"
    return kind_of(result.subject.name).pixels


def folders_of(result: Result) -> Iterator[Path]:
    """Yield where files that a result names are looked for: beside it, one folder up, the working folder."""
    beside = result.path.parent
    above = placed_path(beside).parent, real_path(beside).parent  # two of them where the folder is a link
    yield from (beside, *dict.fromkeys(above), Path())


def places_of(stated: str, folders: Iterable[Path]) -> Iterator[Path]:
    """Yield where a path that a result states may lead: its last part, its last two ... in each folder."""
    path = PurePath(stated)
    parts = [part for part in path.parts if part not in (path.anchor, "..")][-MOST_PARTS:]
    for folder in folders:
        for first in reversed(range(len(parts))):
            yield folder.joinpath(*parts[first:])


def _places(result: Result, stated: str) -> Iterator[Path]:
    """Yield what lies where a recording may be, each once, and never the result."""
    seen = {real_path(result.path)}
    folders = (*folders_of(result), *placed_path(result.path).parents)
    for place in (Path(stated), *places_of(stated, folders)):
        if os.path.exists(place) and (real := real_path(place)) not in seen:  # noqa: PTH110 never raises
            seen.add(real)
            yield place


def _same(path: Path, result: Result, opening: Mapping[str, Any]) -> Recording:
    """Open a recording as the run did; raise RecordingError if it is not the one of the run."""
    run = result.run
    check_kind(path, run)
    check_size(path, run)
    given = {key: value for key, value in opening.items() if value is not None}
    stated, usable = _options_of(run), options_for(path, pixels_of(result))
    options = {key: value for key, value in stated.items() if key in usable}  # some are said of all depth
    _check_given(options, given)
    if "camera_file" in given:
        options.pop("camera_topic", None)
        if run.get("input.kind") == "video":
            options.pop("cameras", None)  # its one camera is called what the file calls it
    with _camera_file(result, given) as camera:
        try:
            recording = open_recording(path, pixels_of(result), **(options | camera | given))
        except RecordingError:
            check_bytes(path, run)  # a file that was changed may lack what the run found in it
            raise
        check_identity(recording, run)  # the camera file is part of a folder's identity
    return recording


def _another(path: Path, result: Result, opening: Mapping[str, Any]) -> Recording:
    """Open a recording that need not be the run's; where it tells no camera, those of the run will do."""
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
        except RecordingError as error:  # about a file that no user knows
            words = str(error).replace(str(file), CAMERA_FILE_NAME).removeprefix(f"{CAMERA_FILE_NAME}: ")
            raise RecordingError(words, where=f"{path}, with the run's camera") from error


def _options_of(run: Mapping[str, str]) -> dict[str, Any]:
    """How the run opened its input, as far as it says."""
    stated = {key: run.get(f"input.{key}", "") for key in _STATED}
    try:
        options = {key: _STATED[key](text) for key, text in stated.items() if text}
    except ValueError as error:
        raise ResultError("run record cannot be read", found=error) from error
    if run.get("input.topics") and run.get("input.calibration") != "camera file":
        options["cameras"] = run["input.topics"].split(",")  # frames' names need not be of one topic only
    if run.get("intrinsics") == "guessed":
        options["guess"] = guess_of_camera(camera_of(run))
    return options


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
def _camera_file(result: Result, given: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """The run's camera file where none is given now."""
    if f"input.{CAMERA_FILE_KEY}" not in result.run or {"camera_file", "camera_topic"} & given.keys():
        yield {}
        return
    with _written(_camera_text(result)) as file:
        yield {"camera_file": file}


@contextmanager
def _written(text: str) -> Iterator[Path]:
    """A camera file of this text, as long as it is needed."""
    with TemporaryDirectory() as folder:
        file = Path(folder) / CAMERA_FILE_NAME
        file.write_bytes(text.encode("utf-8", "backslashreplace"))
        yield file


def _camera_text(result: Result) -> str:
    """The camera file of a run; of one that used none, its cameras as a camera file has them."""
    run = result.run
    if f"input.{CAMERA_FILE_KEY}" in run:
        return run[f"input.{CAMERA_FILE_KEY}"]
    mirrored = run.get("input.mirror") == "true"
    known = result.several_cameras or (camera_of(run),)
    cameras = [camera.mirrored() if mirrored else camera for camera in known]
    return camera_file_text(cameras) if len(cameras) > 1 else _lone_camera_text(cameras[0])


def _lone_camera_text(camera: Camera) -> str:
    """The camera file of one camera, which has no name there."""
    values = {key: value for key, value in camera.values().items() if key != "name"}
    return "".join(f"{key} = {json.dumps(value)}\n" for key, value in values.items())


def camera_of(run: Mapping[str, str]) -> Camera:
    """The camera that a run's estimates are relative to.

    Raises:
        ResultError: the run record does not tell it.
    """
    try:
        return camera_from_json(run["camera"])
    except (KeyError, ValueError, PosetrackError) as error:
        raise ResultError("run record tells no camera", found=error) from error


def cameras_of(result: Result, recording: Recording) -> tuple[Camera, ...]:
    """Return the cameras that a result's estimates were made with.

    Raises:
        UsageError: they cannot have taken these images.
    """
    cameras = result.cameras()
    sizes = [[(camera.width, camera.height) for camera in of] for of in (recording.cameras, cameras)]
    if sizes[0] != sizes[1]:
        found, expected = (", ".join(f"{w}x{h}" for w, h in of) for of in sizes)
        raise UsageError(
            "images are not of the size that was tracked",
            where=recording.path,
            found=found,
            expected=expected,
            hint="pass the --camera of the run, whose crop applies",
        )
    return cameras


# The hand that a result's run tracked, from what the result states of it


def hand_of(result: Result) -> HandModel:
    """Return the hand that a run tracked, from the configuration in its record.

    A hand from a file is looked for by the end of the path that the record states: beside the result, one
    folder up, and in the working folder. A result may be a stranger's, so what it states leads nowhere else,
    and only to a file of the digest that it states.

    Raises:
        ResultError: the record holds no configuration of a hand run, or the hand's file is not found.
        UsageError: the hand's file cannot be used.
    """
    settings = _settings(result)
    if settings.mesh is not None:
        settings = settings.model_copy(update={"mesh": str(_found_mesh(result, settings.mesh))})
    return hand_model(settings)


def anatomy_of(result: Result) -> HandAnatomy:
    """Return the bones of the hand that a run tracked: those of ``hand_of``, without the time its skin takes.

    Raises:
        ResultError, UsageError: as ``hand_of``.
    """
    settings = _settings(result)
    right = make_anatomy() if settings.mesh is None else _anatomy_of_file(_found_mesh(result, settings.mesh))
    return reshaped_anatomy(right, "left" if settings.side == "left" else "right", settings.shape)


def _anatomy_of_file(path: Path) -> HandAnatomy:
    from posetrack_cli.hand.model.webxr import (
        load_hand,  # takes long to import, and few hands are from a file
    )

    return load_hand(path).anatomy


def _settings(result: Result) -> HandSettings:
    try:
        stated: Any = json.loads(result.run["configuration"])["hand"]
        return validated(HandSettings, stated, "run record")
    except (KeyError, TypeError, ValueError, RecursionError, UsageError) as error:
        what = "run record holds no hand's configuration"
        expected = "the record of a hand run"
        raise ResultError(what, where=result.path, found=error, expected=expected) from error


def _found_mesh(result: Result, stated: str) -> Path:
    # imports all that opens recordings

    files = [path for path in places_of(stated, folders_of(result)) if os.path.isfile(path)]  # noqa: PTH113 never raises
    for path in files:
        if file_digest(path)[1] == result.run.get(MESH_DIGEST):
            return path
    if files:
        raise ResultError("not the hand that the run tracked: its file has changed", where=files[0])
    raise ResultError(
        "the hand that the run tracked is not found",
        where=result.path,
        found=f"no {PurePath(stated).name} beside it or in the working folder",
        hint="copy the file there",
    )


def configuration_of(run: Mapping[str, str]) -> HandConfig:
    """The configuration of a hand run, from its record.

    Raises:
        ResultError: the record holds none.
    """
    try:
        return validated(HandConfig, json.loads(run["configuration"]), "run record")
    except (KeyError, TypeError, ValueError, UsageError) as error:
        what = "run record holds no hand's configuration"
        raise ResultError(what, found=error, expected="the record of a hand run") from error
