"""Whether a recording is the one that a result was made from: kind, size and SHA-256 as its record states."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from posetrack_cli.errors import RecordingError
from posetrack_cli.recording.base import RECORDING_KEY
from posetrack_cli.recording.identity import file_digest
from posetrack_cli.recording.recording import Recording

SHOWN_DIGITS = 12
ANY_HINT = "pass the recording of the run with its options; posetrack view --any-recording draws on any"


def check_kind(path: Path, run: Mapping[str, str]) -> None:
    """Tell a folder from a file, whose options are others.

    Raises:
        RecordingError: the run's input was of the other kind.
    """
    kinds = {True: "a folder", False: "a file"}
    is_folder, was_folder = path.is_dir(), run.get("input.kind") == "folder"
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
