"""The images that a head's result was made from: found and known as a hand's recording is."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from posetrack_cli.errors import RecordingError, UsageError
from posetrack_cli.evaluation.recording_identity import check_bytes, check_identity, check_kind, check_size
from posetrack_cli.evaluation.recording_of import camera_of, found_beside
from posetrack_cli.recording.camera_file import CAMERA_FILE_NAME, camera_file_text
from posetrack_cli.recording.guess import guess_of_camera
from posetrack_cli.recording.opening import open_recording
from posetrack_cli.recording.recording import Recording
from posetrack_cli.results.reader import Result

OPTIONS = ("camera_file", "fps", "mirror")
"""What a user may say of images anew."""


def required_images(
    result: Result, given: Path | None = None, *, any_recording: bool = False, **opening: Any
) -> Recording:
    """Return the recording of images that a result was made from.

    Args:
        result: its run record says what to look for, and how it was opened.
        given: the file or folder to take; None looks beside the result, one folder up and in the working
            folder.
        any_recording: take ``given`` whatever it is.
        opening: options that replace those of the run: ``camera_file``, ``fps``, ``mirror``.

    Raises:
        RecordingError: there is none, it cannot be read, or is another.
        UsageError: an option that does not apply.
    """
    recording, reason = search_images(result, given, any_recording=any_recording, **opening)
    if recording is None:
        raise RecordingError(reason)
    return recording


def search_images(
    result: Result, given: Path | None = None, *, any_recording: bool = False, **opening: Any
) -> tuple[Recording | None, str]:
    """As ``required_images``, but not to find any is no error: None and the reason."""
    options = {name: value for name, value in opening.items() if value is not None}
    for name in options.keys() - set(OPTIONS):
        option = f"--{name.replace('_', '-')}"
        raise UsageError(f"{option} does not apply to images", found="a head's result", hint="leave it out")
    if given is not None:
        if any_recording:
            return open_recording(given, "grey", **options), ""
        return _same(given, result, options), ""
    return found_beside(result, lambda place: _same(place, result, options))


def is_of_images(run: Mapping[str, str]) -> bool:
    """Whether a run tracked in grey images, as those of heads do, and not in depth."""
    return run.get("tracker", "").startswith("head")


def _same(path: Path, result: Result, given: Mapping[str, Any]) -> Recording:
    """Open images as the run did; raise RecordingError if they are not those of the run."""
    run = result.run
    check_kind(path, run)
    check_size(path, run)
    with _camera_file(result, given) as camera:
        try:
            recording = open_recording(path, "grey", **(_options_of(run) | camera | dict(given)))
        except RecordingError:
            check_bytes(path, run)  # a file that was changed may lack what the run found in it
            raise
    check_identity(recording, run)
    return recording


def _options_of(run: Mapping[str, str]) -> dict[str, Any]:
    """How the run opened its input, as far as it says."""
    options: dict[str, Any] = {}
    if run.get("input.kind") != "video":
        options["cameras"] = run["input.cameras"].split(",") if "input.cameras" in run else None
        options["tolerance_ms"] = float(run["input.tolerance_ms"]) if "input.tolerance_ms" in run else None
    if "input.fps" in run:
        options["fps"] = float(run["input.fps"])
    if run.get("intrinsics") == "guessed":
        options["guess"] = guess_of_camera(camera_of(run))
    return options | {"mirror": run.get("input.mirror") == "true"}


@contextmanager
def _camera_file(result: Result, given: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """The run's cameras, for an MCAP file that was tracked with a camera file and none is given now."""
    if result.run.get("input.calibration") != "camera file" or "camera_file" in given:
        yield {}
        return
    mirrored = result.run.get("input.mirror") == "true"
    stored = [camera.mirrored() if mirrored else camera for camera in result.cameras()]
    with TemporaryDirectory() as folder:
        file = Path(folder) / CAMERA_FILE_NAME
        file.write_text(camera_file_text(stored), encoding="utf-8", errors="backslashreplace")
        yield {"camera_file": file}
