"""Open a recording by what it is."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from posetrack_cli.errors import RecordingError, UsageError
from posetrack_cli.files import open_input
from posetrack_cli.mcap.records import MAGIC
from posetrack_cli.recording.folder import FolderRecording
from posetrack_cli.recording.guess import Guess
from posetrack_cli.recording.several_cameras import DEFAULT_TOLERANCE_MS, SeveralCamerasRecording
from posetrack_cli.recording.stored import StoredRecording

LONGEST_TOLERANCE_MS = 1000.0


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


def open_images(
    path: Path,
    *,
    cameras: Sequence[str] | None = None,
    camera_file: Path | None = None,
    fps: float | None = None,
    mirror: bool | None = None,
    tolerance_ms: float | None = None,
    guess: Guess | None = None,
) -> SeveralCamerasRecording:
    """Open grey images of one or more calibrated cameras: folders, an MCAP file or a video.

    Frames have uint8 images, None at the place of a camera that has none at that instant; colour is
    converted to luma, of more than 8 bits the upper 8 are kept. ``cameras`` of the recording has the
    reference first, the others placed relative to it.

    Args:
        path: a folder of images, a folder with one folder of images per camera, an MCAP file or a video.
        cameras: names (MCAP: or topics) of those to use; None for all.
        camera_file: camera.toml in place of the recording's own calibration.
        fps: frame rate, Hz, in place of timestamps.csv or a video's own stamps.
        mirror: flip images left to right.
        tolerance_ms: largest difference of stamps within a frame; 10 if None.
        guess: for what needs one camera: what it is taken for where nothing tells its intrinsics; several
            cameras are then refused.

    Raises:
        RecordingError: if it cannot be read, or its cameras are not calibrated.
        UsageError: for an option that does not apply to what ``path`` is, or a value that cannot be used.
    """
    if not path.exists():
        raise RecordingError("no such file or folder", where=path)
    tolerance = _tolerance(tolerance_ms)
    if path.is_dir():
        from posetrack_cli.recording.images_folder import ImagesFolderRecording

        return ImagesFolderRecording(
            path,
            cameras=cameras,
            camera_file=camera_file,
            fps=fps,
            mirror=mirror,
            tolerance_ms=tolerance,
            guess=guess,
        )
    if is_mcap(path):
        _refuse("an MCAP file", fps=fps)
        from posetrack_cli.recording.images_mcap import ImagesMcapRecording

        return ImagesMcapRecording(
            path,
            cameras=cameras,
            camera_file=camera_file,
            mirror=mirror,
            tolerance_ms=tolerance,
            guess=guess,
        )
    _refuse("a video", tolerance_ms=tolerance_ms)
    from posetrack_cli.recording.images_video import ImagesVideoRecording

    return ImagesVideoRecording(
        path, cameras=cameras, camera_file=camera_file, fps=fps, mirror=mirror, guess=guess
    )


def _tolerance(given: float | None) -> float:
    tolerance = DEFAULT_TOLERANCE_MS if given is None else given
    if not 0.0 <= tolerance <= LONGEST_TOLERANCE_MS:
        expected = f"milliseconds from 0 to {LONGEST_TOLERANCE_MS:g}"
        raise UsageError("--tolerance-ms cannot be used", found=f"{tolerance:g}", expected=expected)
    return tolerance


def is_mcap(path: Path) -> bool:
    """Whether a file begins as an MCAP file does.

    Raises:
        RecordingError: if it cannot be read.
    """
    try:
        with open_input(path) as stream:
            return stream.read(len(MAGIC)) == MAGIC
    except OSError as error:
        raise RecordingError("cannot be read", where=path, found=error.strerror or error) from error


def _refuse(what: str, **options: object) -> None:
    """Raise UsageError if any of the options is given."""
    for name, value in options.items():
        if value is not None:
            raise UsageError(f"--{name.replace('_', '-')} does not apply to {what}", found=f"'{value}'")
