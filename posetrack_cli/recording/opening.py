"""Open a recording by what it is."""

from __future__ import annotations

from pathlib import Path

from posetrack_cli.errors import RecordingError, UsageError
from posetrack_cli.recording.folder import FolderRecording
from posetrack_cli.recording.mcap_records import MAGIC
from posetrack_cli.recording.stored import StoredRecording


def open_recording(
    path: Path,
    *,
    topic: str | None = None,
    camera_topic: str | None = None,
    camera_file: Path | None = None,
    fps: float | None = None,
    depth_unit_mm: float | None = None,
    missing: int | None = None,
    mirror: bool | None = None,
) -> StoredRecording:
    """Open a folder of depth images or an MCAP file.

    Args:
        path: folder or file.
        topic, camera_topic: of an MCAP file's depth images and calibration.
        camera_file: camera.toml, in place of the folder's or the file's own calibration.
        fps: frame rate of a folder, Hz, in place of its timestamps.csv.
        depth_unit_mm, missing: of a folder's images: mm per stored unit, code for no reading.
        mirror: flip images left to right.

    Raises:
        RecordingError: if it cannot be read; see ``FolderRecording`` and ``McapRecording``.
        UsageError: for an option that does not apply to what ``path`` is.
    """
    if not path.exists():
        raise RecordingError("no such file or folder", where=path)
    if path.is_dir():
        _refuse("a folder of images", topic=topic, camera_topic=camera_topic)
        return FolderRecording(
            path,
            camera_file=camera_file,
            fps=fps,
            depth_unit_mm=depth_unit_mm,
            missing=missing,
            mirror=mirror,
        )
    if not is_mcap(path):
        raise RecordingError(
            "is not a recording",
            where=path,
            found="an empty file" if path.stat().st_size == 0 else "a file of another kind",
            expected="a folder of 16-bit images or an MCAP file",
        )
    _refuse("an MCAP file", fps=fps, depth_unit_mm=depth_unit_mm, missing=missing)
    if camera_file is not None:
        _refuse("a recording together with --camera", camera_topic=camera_topic)
    from posetrack_cli.recording.mcap_recording import McapRecording

    return McapRecording(path, topic=topic, camera_topic=camera_topic, camera_file=camera_file, mirror=mirror)


def is_mcap(path: Path) -> bool:
    """Whether a file begins as an MCAP file does.

    Raises:
        RecordingError: if it cannot be read.
    """
    try:
        with path.open("rb") as stream:
            return stream.read(len(MAGIC)) == MAGIC
    except OSError as error:
        raise RecordingError("cannot be read", where=path, found=error.strerror or error) from error


def _refuse(what: str, **options: object) -> None:
    """Raise UsageError if any of the options is given."""
    for name, value in options.items():
        if value is not None:
            raise UsageError(f"--{name.replace('_', '-')} does not apply to {what}", found=f"'{value}'")
