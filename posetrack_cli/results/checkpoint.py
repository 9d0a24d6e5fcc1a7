"""The state of an interrupted run, saved beside its unfinished result.

The file is an npz without pickle: the tracker's arrays, one JSON text for everything else, and a digest of
both, so that nothing is gone on with that is not as it was saved.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from posetrack_cli.errors import ResultError
from posetrack_cli.files import open_input, open_output
from posetrack_cli.npz import read_npz
from posetrack_cli.recording.base import PATH_KEY
from posetrack_cli.results.layouts import COUNTS, check_numbers

_ARRAY_PREFIX = "array."
_JSON_KEY, _DIGEST_KEY = "json", "digest"
FORMAT_VERSION = 6
RESTART_HINT = "start again with --overwrite"


@dataclass(frozen=True, eq=False)
class Checkpoint:
    """What a run needs to go on after its last flushed frame.

    Attributes:
        frame_index: of the last frame whose estimate is flushed.
        frames_written: number of estimates flushed.
        arrays: the tracker's arrays by name; plain numbers only, no objects.
        state: the rest of the tracker's state, as JSON can hold it (the random generator's, say).
        fingerprint: of the run; ``ResultWriter.save_checkpoint`` fills it in.
    """

    frame_index: int
    frames_written: int
    arrays: Mapping[str, np.ndarray[Any, Any]] = field(default_factory=dict)
    state: Mapping[str, Any] = field(default_factory=dict)
    fingerprint: str = ""


@dataclass(frozen=True)
class Progress:
    """How far a result was written at its last flush.

    Attributes:
        file_bytes: size of the file.
        flush_frames: estimates per flush, which decides where chunks end.
        truth_messages: how many truth messages were carried over.
        statuses: number of estimates of each status.
    """

    file_bytes: int
    flush_frames: int
    truth_messages: int
    statuses: Mapping[str, int]


def fingerprint(run: Mapping[str, str]) -> str:
    """Return the SHA-256 of a run record; it does not depend on the order of the keys.

    Nor on the recording's path: the recording may have moved meanwhile.
    """
    kept = {key: value for key, value in run.items() if key != PATH_KEY}
    text = json.dumps(kept, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def save(path: Path, checkpoint: Checkpoint, progress: Progress) -> None:
    """Write both to one file, so that at any moment there is the old file or the new one, never half.

    Raises:
        ResultError: the file cannot be written, or the state is not of the allowed types.
    """
    temporary = path.with_name(path.name + ".tmp")
    contents = _contents(path, checkpoint, progress)
    try:
        with open_output(temporary) as stream:
            np.savez(stream, **contents)  # type: ignore[arg-type]
            stream.flush()
            os.fsync(stream.fileno())
        temporary.replace(path)
    except OSError as error:
        raise ResultError("cannot be written", where=temporary, found=error.strerror or error) from error


def load(path: Path) -> tuple[Checkpoint, Progress]:
    """Read what ``save`` wrote.

    Raises:
        ResultError: the file is missing, of another version, damaged, or not as ``save`` wrote it.
    """
    try:
        with open_input(path) as stream:
            return _parsed(read_npz(stream))
    except FileNotFoundError as error:
        raise ResultError("no checkpoint to resume from", where=path, hint=RESTART_HINT) from error
    except OSError as error:
        what = "checkpoint cannot be read"
        raise ResultError(what, where=path, found=error.strerror or error, hint=RESTART_HINT) from error
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        found = f"no {error}" if isinstance(error, KeyError) else error
        raise ResultError("checkpoint cannot be read", where=path, found=found, hint=RESTART_HINT) from error


def _parsed(contents: Mapping[str, np.ndarray[Any, Any]]) -> tuple[Checkpoint, Progress]:
    """Return what a file's arrays say.

    Raises:
        ValueError, KeyError, TypeError, RecursionError: they are not as ``save`` made them.
    """
    fields = json.loads(contents[_JSON_KEY].tobytes())
    check_numbers(fields, {"version": (FORMAT_VERSION, FORMAT_VERSION)})
    if contents[_DIGEST_KEY].tobytes() != _digest(contents):
        raise ValueError("contents that do not fit their digest")
    kept, progress = fields["checkpoint"], fields["progress"]
    check_numbers(kept, {"frame_index": (-1, COUNTS[1]), "frames_written": COUNTS})
    check_numbers(progress, {"file_bytes": COUNTS, "flush_frames": (1, COUNTS[1]), "truth_messages": COUNTS})
    if not (isinstance(kept["state"], dict) and isinstance(kept["fingerprint"], str)):
        raise ValueError("a state of another kind")
    names = [name for name in contents if name.startswith(_ARRAY_PREFIX)]
    arrays = {name.removeprefix(_ARRAY_PREFIX): contents[name] for name in names}
    return Checkpoint(arrays=arrays, **kept), Progress(**progress)


def _digest(contents: Mapping[str, np.ndarray[Any, Any]]) -> bytes:
    """Return the SHA-256 of all arrays but the digest: of names, types, shapes and bytes."""
    digest = hashlib.sha256()
    for name in sorted(contents.keys() - {_DIGEST_KEY}):
        array = contents[name]
        digest.update(json.dumps([name, array.dtype.str, array.shape]).encode())
        digest.update(array.tobytes())
    return digest.digest()


def _contents(path: Path, checkpoint: Checkpoint, progress: Progress) -> dict[str, np.ndarray[Any, Any]]:
    """Return the arrays of the npz file."""
    for name, array in checkpoint.arrays.items():
        if np.asarray(array).dtype.hasobject:
            raise ResultError(f"state '{name}' cannot be saved", where=path, found="Python objects")
    kept = {
        name: getattr(checkpoint, name) for name in ("frame_index", "frames_written", "state", "fingerprint")
    }
    kept["state"] = dict(kept["state"])
    fields = {"version": FORMAT_VERSION, "checkpoint": kept, "progress": asdict(progress)}
    try:
        text = json.dumps(fields).encode()
    except TypeError as error:
        raise ResultError("state cannot be saved", where=path, found=error) from error
    arrays = {f"{_ARRAY_PREFIX}{name}": np.asarray(array) for name, array in checkpoint.arrays.items()}
    contents = {_JSON_KEY: np.frombuffer(text, dtype=np.uint8), **arrays}
    return {**contents, _DIGEST_KEY: np.frombuffer(_digest(contents), dtype=np.uint8)}
