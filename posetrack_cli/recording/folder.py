"""Folders of images as recordings: 16-bit depth, or grey images with one folder per camera."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from posetrack_cli import limits
from posetrack_cli.arrays import ImageArray
from posetrack_cli.errors import RecordingError, UsageError
from posetrack_cli.files import placed_path, read_text
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.losses import LossLog
from posetrack_cli.mcap.stream import McapFile, is_mcap
from posetrack_cli.recording.base import (
    CAMERA_FILE_NAME,
    TRUTH_FILE_NAME,
    TRUTH_PREFIX,
    Encoded,
    StoredImage,
    TruthMessage,
    UnreadableImageError,
    no_intrinsics,
    not_encoded,
    truth_message,
)
from posetrack_cli.recording.camera_file import (
    TABLE,
    DepthCamera,
    Rig,
    camera_record,
    image_camera,
    load_depth_camera,
    load_or_guess_rig,
    load_rig,
    nominal_hint,
)
from posetrack_cli.recording.camera_of import GUESSED, require_single_camera
from posetrack_cli.recording.depth import (
    Depth,
    DepthContent,
    DepthEncoding,
    content_of,
    decide_unit,
    early,
    other_content,
)
from posetrack_cli.recording.exif import focal_ratio_of_file
from posetrack_cli.recording.grey import PLAIN_BITS, Grey, decode_shown, grey_like, with_bits_of
from posetrack_cli.recording.identity import files_digest, identity_record
from posetrack_cli.recording.image_files import (
    ImageFile,
    decode_codes,
    encoded_file,
    files_of,
    first_decoded,
    read_image,
)
from posetrack_cli.recording.image_folders import CameraFolders, Stamped, find_depth, find_folders
from posetrack_cli.recording.matching import NS_PER_MS
from posetrack_cli.recording.orientation import (
    UPRIGHT,
    Orientation,
    Picture,
    orientation_of_decoding,
    orientation_of_file,
)
from posetrack_cli.recording.pixels import Pixels, Window
from posetrack_cli.recording.recording import (
    CameraStream,
    ReadingOptions,
    Recording,
    match_streams,
    no_truth,
    tolerance_ns,
)

SPREAD = 9  # images sampled across a folder to find the significant bits


def open_depth_folder(path: Path, options: ReadingOptions) -> Recording:
    """Open a folder of 16-bit depth images, sorted by name, with camera.toml and stamps.

    Raises:
        RecordingError: there are no images, intrinsics or stamps, or the first readable image is not 16-bit
            single-channel or does not fit the camera file. Later images of another size or kind raise it
            during reading; unreadable ones are skipped and counted.
        UsageError: an option is invalid.
    """
    images_of = find_depth(path)
    (images,) = images_of.by_name.values()
    folder = images[0].parent
    first, turn = first_decoded(images, _depth_and_turn)
    height, width = first.shape
    file = depth_camera_path(path, options.get("camera_file"), folder, (width, height))
    settings = _overridden(load_depth_camera(file), options)
    if (other := other_content(placed_path(folder).name)) and settings.depth_unit_mm is None:
        raise RecordingError(
            f"folder is named '{other}', so its images are not read as depth",
            where=folder,
            found=f"{len(images)} images",
            hint="if they are depth, pass --depth-unit-mm, e.g. 1",
        )
    timing = images_of.timing(options.get("fps"), nominal_fps=settings.fps)
    found = image_camera(settings, file, (width, height), orientation=turn)
    decision = decide_unit(_early_content(images, found.camera, settings.missing), settings.depth_unit_mm)
    encoding: DepthEncoding = "16UC1" if decision.unit_mm == 1.0 and first.dtype.kind == "u" else "32FC1"
    pixels = Depth(
        width, height, encoding, decision.unit_mm, settings.missing, is_float=first.dtype.kind == "f"
    )
    camera = settings.window.camera(found.camera)
    is_copied = encoding == "16UC1" and settings.missing == 0
    (stamped,) = timing.stamped.values()
    stream = _stream(camera, pixels, settings.window, "", stamped, _encoded if is_copied else None)

    def identity() -> Mapping[str, str]:
        files = [(image.name, image) for image in files_of(images)]
        files += [(file.name, file) for file in timing.files]
        return {
            **identity_record(path, "folder", files_digest([*files, (CAMERA_FILE_NAME, file)])),
            "frames": str(len(images)),
            "depth_unit_mm": str(decision.unit_mm),
            "missing": str(settings.missing),
            "mirror": str(settings.mirror).lower(),
            **_rate(timing.fps),
            **camera_record(options.get("camera_file")),
        }

    return Recording(
        path,
        [stream],
        identity=identity,
        frame_count=len(images),
        why=[found.why],
        remarks=(*images_of.every_remark, *timing.remarks, *found.remarks, *decision.remarks),
    )


def _depth_and_turn(image: ImageFile) -> tuple[ImageArray, Orientation]:
    data = read_image(image)
    return decode_codes(data, str(image)), orientation_of_decoding(data)


def _early_content(images: Sequence[ImageFile], camera: Camera, missing: int) -> DepthContent:
    """Return statistics of early images, skipping those that cannot be decoded."""
    decoded: list[ImageArray] = []
    for image in early(images):
        with suppress(UnreadableImageError, RecordingError):
            decoded.append(decode_codes(read_image(image), str(image)))
    return content_of(decoded, camera, missing)


def open_grey_folder(path: Path, options: ReadingOptions) -> Recording:
    """Open a folder of grey images (one camera), or of one image folder per camera.

    Raises:
        RecordingError: there are no images or stamps, a camera is not calibrated or has no folder, or sizes
            do not match. Later images of another size raise it during reading; unreadable ones are skipped
            and counted.
        UsageError: an option is invalid.
    """
    every, tolerance = _without_depth(find_folders(path), options), tolerance_ns(options)
    rig = _rig_of(every, options)
    first = next(iter(rig.cameras.values()))
    chosen = _folders_of(every, rig)
    folders = chosen.by_name
    timing = chosen.timing(options.get("fps"), tolerance, nominal_fps=first.fps)
    kinds = {name: _first_grey(rig, name, images) for name, images in folders.items()}
    if options.get("in_colour"):
        kinds = {name: replace(kind, keeps_colour=True) for name, kind in kinds.items()}
    windows = {name: rig.window(name, options.get("mirror")) for name in folders}
    turns = {name: first_decoded(images, _orientation) for name, images in folders.items()}
    sizes = {name: Picture(kind.width, kind.height, turns[name]) for name, kind in kinds.items()}
    stored = rig.stored_cameras(sizes)
    streams = [
        _stream(
            windows[name].camera(camera),
            kinds[name],
            windows[name],
            name,
            timing.stamped[name],
            _encoded_upright if kinds[name].bits == PLAIN_BITS else None,
        )
        for name, camera in zip(folders, stored, strict=True)
    ]
    count = sum(1 for _ in match_streams(streams, tolerance, LossLog()))
    mirror = next(iter(windows.values())).mirror

    def identity() -> Mapping[str, str]:
        files = [(_label(name, image), image) for name, all_ in folders.items() for image in files_of(all_)]
        files += [(f"{i} {file.name}", file) for i, file in enumerate(timing.files)]
        files += [] if rig.is_guessed else [(CAMERA_FILE_NAME, rig.path)]
        return {
            **identity_record(path, "folder", files_digest(files)),
            "frames": str(count),
            "cameras": ",".join(stream.camera.name for stream in streams),
            "stored": ", ".join(dict.fromkeys(kind.words for kind in kinds.values())),
            "mirror": str(mirror).lower(),
            "tolerance_ms": f"{tolerance / NS_PER_MS:g}",
            **_rate(timing.fps),
            **camera_record(options.get("camera_file")),
        }

    return Recording(
        path,
        streams,
        identity=identity,
        frame_count=count,
        # truth does not apply to a mirrored scene, nor can synthetic stamps be matched with it
        truth=no_truth if mirror or timing.fps else _truth(path),
        tolerance_ns=tolerance,
        is_guessed=rig.is_guessed,
        stated_focal=_stated_focal(next(iter(folders.values())), streams[0]) if rig.is_guessed else None,
        why=[GUESSED if rig.is_guessed else rig.path.name] * len(streams),
        remarks=(*chosen.every_remark, *timing.remarks, *_turned(turns), *rig.remarks(sizes)),
    )


def _truth(folder: Path) -> Callable[[], Iterator[TruthMessage]]:
    path = folder / TRUTH_FILE_NAME
    if not (path.is_file() and is_mcap(path)):
        return no_truth
    file = McapFile(path)
    return lambda: map(truth_message, file.messages(lambda topic: topic.startswith(TRUTH_PREFIX)))


def depth_camera_path(folder: Path, camera_file: Path | None, images: Path, size: tuple[int, int]) -> Path:
    """Return the camera file for images of a size: the given one, else the folder's.

    If the images are in a subfolder, it may hold the file instead.

    Raises:
        RecordingError: no file is given and none exists.
    """
    own = folder / CAMERA_FILE_NAME
    path = camera_file or (own if own.exists() else images / CAMERA_FILE_NAME)
    if camera_file is None and not path.exists():
        raise no_intrinsics(folder, nominal_hint(*size))
    return path


def _overridden(settings: DepthCamera, options: ReadingOptions) -> DepthCamera:
    given = {key: options.get(key) for key in ("depth_unit_mm", "missing", "mirror")}
    values = {key: value for key, value in given.items() if value is not None}
    try:
        return DepthCamera.model_validate(settings.model_dump() | values)
    except ValueError as error:
        text = ", ".join(f"{key} {value}" for key, value in values.items())
        raise UsageError("invalid depth option", found=text) from error


def _stream(
    camera: Camera,
    pixels: Pixels,
    window: Window,
    folder: str,
    stamped: Stamped,
    encoded: Callable[[ImageFile], Encoded | None] | None,
) -> CameraStream:
    """Return the stream of one camera; ``encoded`` returns a file's content for a message."""

    def images(losses: LossLog) -> Iterator[StoredImage]:
        for stamp, image in stamped:
            own = partial(encoded, image) if encoded and window.keeps_pixels else not_encoded
            yield StoredImage(stamp, _label(folder, image), partial(_decoded, image, pixels, window), own)

    return CameraStream(camera, pixels, images)


def _decoded(image: ImageFile, pixels: Pixels, window: Window) -> ImageArray:
    return window.apply(pixels.from_file(read_image(image), image))


def _encoded(image: ImageFile) -> Encoded | None:
    return encoded_file(read_image(image))


def _encoded_upright(image: ImageFile) -> Encoded | None:
    """Return an image for a message, which is read as stored; None if EXIF rotates it."""
    data = read_image(image)
    return encoded_file(data) if orientation_of_file(data) == UPRIGHT else None


def _rate(fps: float | None) -> dict[str, str]:
    return {} if fps is None else {"fps": str(fps)}


def _label(folder: str, image: ImageFile | Path) -> str:
    return f"{folder}/{image.name}" if folder else image.name


def _rig_of(folders: CameraFolders, options: ReadingOptions) -> Rig:
    """Return the cameras to use; at most one if intrinsics may be guessed."""
    guess, names = options.get("guess"), options.get("cameras")
    file = _camera_file(folders.path, options.get("camera_file"))
    rig = load_or_guess_rig(folders.path, file, folders.by_name, guess)
    rig = _named_rig(folders, rig) if names is None else rig.subset(names)
    if guess is not None:
        require_single_camera(folders.path, rig.cameras)
    return rig


def _named_rig(folders: CameraFolders, rig: Rig) -> Rig:
    """Return the default cameras, matched by names of folders and camera file."""
    unknown = [name for name in folders.by_name if name and name not in rig.cameras]
    if unknown and "" not in rig.cameras:
        raise RecordingError(
            f"camera '{unknown[0]}' is not calibrated",
            where=folders.path,
            found=f"[cameras.NAME] for {', '.join(rig.cameras)} in {rig.path.name}",
            hint="run posetrack calibrate stereo, or choose calibrated cameras with --cameras",
        )
    if "" not in folders.by_name or len(rig.cameras) == 1:
        return rig
    name = placed_path(folders.path).name
    if name not in rig.cameras:
        raise UsageError(
            "one image folder but several calibrated cameras",
            where=folders.path,
            found=", ".join(rig.cameras),
            hint="choose one with --cameras",
        )
    return rig.subset([name])


def _camera_file(path: Path, given: Path | None) -> Path | None:
    """Return the given camera file, the folder's, or that of the parent recording with this camera."""
    above = placed_path(path).parent / CAMERA_FILE_NAME
    own = path / CAMERA_FILE_NAME
    if given is not None or own.exists():
        return given or own
    if above.exists() and _is_of_rig(above) and placed_path(path).name in load_rig(above).cameras:
        return above
    return None


def _is_of_rig(file: Path) -> bool:
    """Return whether a camera file describes several cameras rather than one depth camera."""
    try:
        return TABLE in read_text(file, limits.TEXT_BYTES)
    except (OSError, UnicodeDecodeError):
        return True  # loading it reports the error


def _without_depth(folders: CameraFolders, options: ReadingOptions) -> CameraFolders:
    """Return all cameras except depth folders, unless options or the camera file name them."""
    file = _camera_file(folders.path, options.get("camera_file"))
    return folders.without_depth(
        [*(options.get("cameras") or ()), *(() if file is None else load_rig(file).cameras)]
    )


def _folders_of(folders: CameraFolders, rig: Rig) -> CameraFolders:
    """Return the images of each camera of the rig, in its order."""
    path, by_name = folders.path, folders.by_name
    if len(by_name) == len(rig.cameras) == 1:
        return folders.renamed(next(iter(rig.cameras)))
    found = ", ".join(by_name) if "" not in by_name else "images of one camera"
    if "" in rig.cameras:
        hint = "write a table [cameras.NAME] for each, e.g. with posetrack calibrate stereo"
        raise RecordingError("several cameras but the calibration of one", where=path, found=found, hint=hint)
    for name in rig.cameras:
        if name not in by_name:
            raise RecordingError(
                f"no images of camera '{name}'", where=path, found=found, expected=f"a folder {name}"
            )
    return folders.of(rig.cameras)


def _stated_focal(images: Sequence[ImageFile], stream: CameraStream) -> float | None:
    """Return the focal length over the longer side that the EXIF of the first image states."""
    width, height = stream.camera.width, stream.camera.height
    return first_decoded(images, lambda image: focal_ratio_of_file(read_image(image), width, height))


def _orientation(image: ImageFile) -> Orientation:
    return orientation_of_file(read_image(image))


def _turned(turns: Mapping[str, Orientation]) -> Iterator[str]:
    """Yield a remark for each camera whose images EXIF rotates or mirrors."""
    for name, orientation in turns.items():
        if orientation != UPRIGHT:
            of = f" of camera '{name}'" if name else ""
            yield f"images{of} are {orientation.words} by their EXIF orientation"


def _first_grey(rig: Rig, name: str, images: Sequence[ImageFile]) -> Grey:
    """Return the pixel format from the first decodable image, with significant bits from several."""
    bits = rig.cameras[name].bits
    kind = first_decoded(images, lambda image: grey_like(decode_shown(read_image(image)), image, bits))
    return kind if bits is not None or kind.bits == PLAIN_BITS else with_bits_of(kind, _spread(images))


def _spread(images: Sequence[ImageFile]) -> Iterator[ImageArray]:
    """Yield decodable images sampled from the first to the last of a folder."""
    for place in np.unique(np.linspace(0, len(images) - 1, SPREAD).round().astype(int)):
        with suppress(UnreadableImageError):
            yield decode_shown(read_image(images[place]))
