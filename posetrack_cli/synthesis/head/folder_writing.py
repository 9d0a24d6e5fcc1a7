"""A synthetic recording as a folder of images, as cameras' software leaves them."""

from __future__ import annotations

import shutil
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np

from posetrack_cli.errors import ResultError, UsageError
from posetrack_cli.mcap.sink import McapSink
from posetrack_cli.outputs import check_place, is_taken, part_path
from posetrack_cli.recording.camera_file import CAMERA_FILE_NAME, camera_file_text
from posetrack_cli.recording.stamps import STAMPS_FILE_NAME
from posetrack_cli.synthesis.head.encoding import SUFFIXES, encoded
from posetrack_cli.synthesis.head.frames import Plan, SyntheticHeadFrame
from posetrack_cli.synthesis.head.truth import TruthChannels

TRUTH_FILE_NAME = "truth.mcap"
SYNTH_RECORD = "posetrack.synth"
OWN_NAMES = {CAMERA_FILE_NAME, STAMPS_FILE_NAME, TRUTH_FILE_NAME, "left", "right", "camera"}


def check_folder_output(out: Path, *, overwrite: bool) -> None:
    """Refuse a folder that cannot be written, or would replace what it must not.

    Raises:
        UsageError: something is there that may not be replaced: without ``overwrite`` anything, with it
        what is
            no synthetic recording.
        ResultError: the folder above does not exist.
    """
    if out.suffix:
        raise UsageError("output cannot be used", where=out, expected="NAME.mcap, or a folder without a dot")
    check_place(out)
    if not is_taken(out):
        return
    if not overwrite:
        raise UsageError("exists already", where=out, hint="use --overwrite to replace it")
    if not _is_synthetic(out):
        raise UsageError("is no synthetic recording, so it is not replaced", where=out)


def write_folder(
    out: Path,
    plan: Plan,
    frames: Iterable[SyntheticHeadFrame],
    image_format: str,
    record: Mapping[str, str],
) -> None:
    """Write a folder: NAME.part while it is written, deleted after any failure.

    Raises:
        ResultError: it cannot be written.
    """
    part = part_path(out)
    try:
        if part.exists():
            shutil.rmtree(part)
        part.mkdir()
        _write(part, plan, frames, image_format, record)
        if out.exists():
            shutil.rmtree(out)
        part.replace(out)
    except OSError as error:
        raise ResultError("cannot be written", where=out, found=error.strerror or error) from error
    finally:
        shutil.rmtree(part, ignore_errors=True)


def _write(
    folder: Path,
    plan: Plan,
    frames: Iterable[SyntheticHeadFrame],
    image_format: str,
    record: Mapping[str, str],
) -> None:
    names = [f"{index:06d}{SUFFIXES[image_format]}" for index in range(len(plan.stamps_ns))]
    taken = np.flatnonzero((~plan.dropped).any(axis=0)).tolist()
    rows = [f"{names[index]},{int(plan.stamps_ns[index])}\n" for index in taken]
    (folder / STAMPS_FILE_NAME).write_text("".join(["filename,stamp_ns\n", *rows]), encoding="utf-8")
    comments = ["Cameras of a synthetic recording; the truth is in truth.mcap."]
    (folder / CAMERA_FILE_NAME).write_text(camera_file_text(plan.cameras, comments), encoding="utf-8")
    for camera in plan.cameras:
        (folder / camera.name).mkdir()
    with McapSink(folder / TRUTH_FILE_NAME) as sink:
        sink.metadata(SYNTH_RECORD, record)
        truth = TruthChannels(sink, plan.cameras[0].name)
        for frame in frames:
            for camera, image in zip(plan.cameras, frame.images, strict=True):
                if image is not None:
                    (folder / camera.name / names[frame.index]).write_bytes(encoded(image, image_format))
            truth.write(frame)
        sink.finish()


def _is_synthetic(out: Path) -> bool:
    """Whether a folder holds what is written here, and nothing else."""
    if out.is_symlink() or not out.is_dir():
        return False
    names = {entry.name for entry in out.iterdir()}
    return not names or (TRUTH_FILE_NAME in names and names <= OWN_NAMES)
