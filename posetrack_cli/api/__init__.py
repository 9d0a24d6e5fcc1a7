"""Python interface: read results, track arrays or recordings, evaluate.

``import posetrack_cli as posetrack`` provides these names. They follow semantic versioning: within a major
version, parameters and results only gain members. All other modules are internal.
"""

from __future__ import annotations

import warnings
from collections.abc import Generator, Iterator, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Literal

from posetrack_cli.errors import UsageError

if TYPE_CHECKING:
    from types import TracebackType
    from typing import Self, Unpack

    from posetrack_cli.configuration import Model
    from posetrack_cli.evaluation.measuring.evaluation import Evaluation
    from posetrack_cli.geometry.camera import Camera
    from posetrack_cli.recording.array_source import Images
    from posetrack_cli.recording.pixels import PixelKind
    from posetrack_cli.recording.recording import ReadingOptions, Recording
    from posetrack_cli.results.estimate import Estimate, Subject
    from posetrack_cli.results.reader import Result
    from posetrack_cli.tracking.options import RunOutcome
    from posetrack_cli.tracking.run import Run

_RESULT = "result.mcap"


def read(path: Path | str) -> Result:
    """Open a result; arrays are read on demand.

    ``to_numpy()``, ``to_pandas()`` and ``to_xarray()`` of the returned object give a whole track, and
    ``estimates()`` one frame after the other in constant memory.

    Args:
        path: a result of ``posetrack``, also an unfinished or damaged one.

    Raises:
        ResultError: not a result.
    """
    from posetrack_cli.results.reader import read_result

    return read_result(path)


def open_recording(
    path: Path | str, kind: PixelKind = "depth", **options: Unpack[ReadingOptions]
) -> Recording:
    """Open a recording for reading its images.

    ``frames()`` yields frames with ``index``, ``stamp_ns`` and ``images``, one array per camera; ``cameras``
    has their calibration. Recordings can also be passed to ``track_hand`` and ``track_head``.

    Args:
        path: any recording that the command line reads.
        kind: ``depth`` (float32 mm, 0 for no reading) or ``grey`` (uint8).
        options: reading options, such as ``fps`` or ``camera_file``.

    Raises:
        PosetrackError: the recording cannot be read, as one line.
    """
    from posetrack_cli.recording import opening

    if (file := options.get("camera_file")) is not None:
        options["camera_file"] = Path(file)  # as text, like the path
    return opening.open_recording(Path(path), kind, **options)


class Tracking:
    """Estimates of a run, one per frame, in order; iterate once.

    Closing it early, or leaving it as a context manager, ends the run; its output then stays unfinished and
    can be resumed. Until the run ends, linear algebra of numpy and scipy uses one thread in this process.

    Attributes:
        run: run record.
        outcome: counts, losses and remarks; None before the last frame.
    """

    def __init__(self, run: Run, folder: ExitStack) -> None:
        self.run: Mapping[str, str] = run.record
        self.outcome: RunOutcome | None = None
        self._folder, self._run = folder, run
        self._estimates = self._each(run)

    @property
    def subject(self) -> Subject:
        """Tracked subject, with names of points and shape parameters; the first of several."""
        return self._run.subject

    @property
    def current(self) -> tuple[Estimate, ...]:
        """Estimates of all subjects in the last frame, such as one per face."""
        return self._run.current

    def _each(self, run: Run) -> Generator[Estimate, None, None]:
        try:
            self.outcome = yield from run.estimates()
        finally:
            self._folder.close()

    def __iter__(self) -> Iterator[Estimate]:
        return self

    def __next__(self) -> Estimate:
        return next(self._estimates)

    def close(self) -> None:
        """End the run."""
        self._estimates.close()
        self._folder.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def track_hand(
    depth: Images | Recording | Path | str,
    camera: Camera | Path | str | None = None,
    *,
    fps: float | None = None,
    stamps_ns: Sequence[int] | None = None,
    depth_unit_mm: float | None = None,
    side: Literal["auto", "right", "left"] = "auto",
    shape: str | Path = "auto",
    config: str | Path | Sequence[str | Path] = (),
    settings: Mapping[str, Any] | None = None,
    seed: int = 0,
    smooth: bool = False,
    output: Path | str | None = None,
    overwrite: bool = False,
    resume: bool = False,
    device: int | Literal["cpu"] | None = None,
) -> Tracking:
    """Track a hand in depth images; same as ``posetrack hand run --hands 1``, with the same defaults.

    With the setting ``hand.count`` of ``2``, both hands are written to ``output``, and iteration yields the
    estimates of the right one.

    Side, size and shape are estimated before this function returns, which takes about five seconds. Warns if
    the estimate is doubtful.

    Args:
        depth: N images (height, width), a list, an array or a memory map of integers or floats with 0 for no
            reading; or a recording, or its path.
        camera: of the images. For a recording a camera file, or None for its own calibration.
        fps: frame rate, Hz. Arrays need either this or stamps.
        stamps_ns: (N,) stamps, ns, strictly increasing.
        depth_unit_mm: millimetres per stored unit; None decides by content (integers mm, floats m).
        side: which hand it is.
        shape: ``auto``, ``average``, a file of ``posetrack hand calibrate``, or an earlier hand result.
        config: shipped configurations or TOML files; later ones override earlier ones.
        settings: values by configuration key, such as ``{"filter.particles": 128}``.
        seed: of the random generator; equal inputs and seeds give equal estimates.
        smooth: also write the smoothed track to ``output``.
        output: result file (MCAP); None keeps no file.
        overwrite: replace an existing result.
        resume: continue an interrupted run; yields the remaining frames.
        device: ``cpu``, the number of a GPU, or None for the fastest.

    Returns:
        Estimates; position in mm in camera axes (x right, y down, z forward), quaternion x y z w, angles in
        rad, joints (21, 3) in mm.

    Raises:
        PosetrackError: unusable input, configuration or output, as one line.
    """
    from posetrack_cli.configuration import parse_assignments
    from posetrack_cli.hand.autodetect import detect_hand
    from posetrack_cli.hand.config import HandConfig
    from posetrack_cli.hand.run import HandRun, RunOptions, check_run
    from posetrack_cli.hand.shape_fit import read_shape
    from posetrack_cli.recording.array_source import open_depth_arrays
    from posetrack_cli.recording.recording import Recording
    from posetrack_cli.rendering.devices import open_fastest_device

    files = _as_list(config)
    given = read_shape(None if shape == "auto" else shape)
    own = {"hand.side": None if side == "auto" else side, "init.shape": given.init}
    values = {"hand.count": "1", **parse_assignments(given.assignments), **(settings or {}), **own}
    configuration = _configured(HandConfig, [*files, *given.files], values)
    if isinstance(depth, Recording):
        _check_unset(camera=camera, fps=fps, stamps_ns=stamps_ns, depth_unit_mm=depth_unit_mm)
        recording = depth
    elif isinstance(depth, Path | str):
        file = _camera_file(camera, stamps_ns)
        recording = open_recording(depth, fps=fps, depth_unit_mm=depth_unit_mm, camera_file=file)
    else:
        recording = open_depth_arrays(
            depth, _one_camera(camera), fps=fps, stamps_ns=stamps_ns, depth_unit_mm=depth_unit_mm
        )
    path, folder = _output(output, smooth=smooth, resume=resume)
    options = RunOptions(path, seed=seed, smooth=smooth, overwrite=overwrite, resume=resume)
    with folder:
        renderer = open_fastest_device(device)
        check_run(recording, configuration, options)
        found = detect_hand(recording, configuration, 0, None)
        if found.is_doubtful:
            warnings.warn(found.line, stacklevel=2)
        return Tracking(HandRun(recording, found.config, options, renderer), folder.pop_all())


def track_head(
    images: Images | Mapping[str, Images] | Recording | Path | str,
    cameras: Camera | Sequence[Camera] | Path | str = (),
    *,
    fps: float | None = None,
    stamps_ns: Sequence[int] | None = None,
    fov_deg: float | None = None,
    face: int = 1,
    faces: Literal["all"] | None = None,
    person: Path | str | None = None,
    config: str | Path | Sequence[str | Path] = (),
    settings: Mapping[str, Any] | None = None,
    seed: int = 0,
    smooth: bool = False,
    output: Path | str | None = None,
    overwrite: bool = False,
    resume: bool = False,
) -> Tracking:
    """Track a head; same as ``posetrack head mono``, or ``head stereo`` with several cameras.

    Warns if the focal length is estimated.

    Args:
        images: N images (height, width) or (height, width, 3) in blue, green, red; several cameras as a
            mapping from name to images; or a recording, or its path.
        cameras: of the images, the reference first, with names as in ``images``; none for one uncalibrated
            camera. For a recording a camera file, or none for its own calibration.
        fps, stamps_ns: see ``track_hand``.
        fov_deg: field of view along the longer side of one uncalibrated camera; None estimates it.
        face: which face to track with one camera, 1 for the largest.
        faces: ``all`` tracks each face, in two passes. Iteration yields estimates of the first; the attribute
            ``current`` has those of all faces.
        person: earlier head result of the same person, whose shape and size one camera then uses.
        config, settings, seed, smooth, output, overwrite, resume: see ``track_hand``.

    Returns:
        Estimates; position in mm in axes of the reference camera, quaternion x y z w, ten points (10, 3) in
        mm. With two passes (the default for one camera) the first estimate follows the first pass.

    Raises:
        PosetrackError: unusable input, configuration or output, as one line.
    """
    from posetrack_cli.head.config import HeadMonoConfig, HeadStereoConfig
    from posetrack_cli.head.run import HeadRunOptions
    from posetrack_cli.head.runs import guess_note, make_heads_run, make_mono_run, make_stereo_run

    recording = _head_recording(images, cameras, fps, stamps_ns, fov_deg)
    path, folder = _output(output, smooth=smooth, resume=resume)
    known = None if person is None else Path(person)
    options = HeadRunOptions(path, seed=seed, smooth=smooth, overwrite=overwrite, resume=resume, person=known)
    files, own = _as_list(config), dict(settings or {})
    with folder:
        if len(recording.cameras) > 1:
            if person is not None:
                raise UsageError("person applies to one camera", found=f"{len(recording.cameras)} cameras")
            stereo = _configured(HeadStereoConfig, files, own)
            run = make_stereo_run(recording, stereo, options, _ignore, all_faces=faces is not None)
        else:
            mono = _configured(HeadMonoConfig, files, own)
            known_fov = fov_deg is not None
            if faces is not None and face != 1:
                raise UsageError("face and faces are mutually exclusive", found=face)
            if faces is None:
                run = make_mono_run(recording, mono, options, face, _ignore, fov_is_given=known_fov)
            else:
                run = make_heads_run(recording, mono, options, _ignore, fov_is_given=known_fov)
            note = guess_note(run, "fov_deg")
            if note and fov_deg is None:
                warnings.warn(note, stacklevel=2)
        return Tracking(run, folder.pop_all())


def _head_recording(
    images: Images | Mapping[str, Images] | Recording | Path | str,
    cameras: Camera | Sequence[Camera] | Path | str,
    fps: float | None,
    stamps_ns: Sequence[int] | None,
    fov_deg: float | None,
) -> Recording:
    """Return the recording that the first parameters of ``track_head`` state."""
    from posetrack_cli.geometry.camera import Camera
    from posetrack_cli.recording.array_source import open_grey_arrays
    from posetrack_cli.recording.base import NotCalibratedError
    from posetrack_cli.recording.camera_of import Guess, guess_of_field
    from posetrack_cli.recording.recording import Recording

    if cameras and fov_deg is not None:
        raise UsageError("cameras and fov_deg are mutually exclusive", hint="leave one of them out")
    guess = Guess() if fov_deg is None else guess_of_field(fov_deg)
    if isinstance(images, Recording):
        _check_unset(cameras=cameras or None, fps=fps, stamps_ns=stamps_ns)
        recording = images
    elif isinstance(images, Path | str):
        file = _camera_file(cameras or None, stamps_ns)
        try:
            recording = open_recording(images, "grey", fps=fps, camera_file=file)
        except NotCalibratedError:  # a guess is for one camera: with it a calibrated rig would be refused
            recording = open_recording(images, "grey", fps=fps, camera_file=file, guess=guess)
    elif isinstance(cameras, Path | str):
        raise UsageError("images are arrays", found=f"cameras {cameras}", expected="posetrack.Camera objects")
    else:
        rig = [cameras] if isinstance(cameras, Camera) else list(cameras)
        by_name = images if isinstance(images, Mapping) else {rig[0].name if rig else "camera": images}
        recording = open_grey_arrays(by_name, rig, fps=fps, stamps_ns=stamps_ns, guess=None if rig else guess)
    if fov_deg is not None and not recording.is_guessed:
        raise UsageError(
            "fov_deg cannot be used with a calibrated camera", found=fov_deg, hint="leave it out"
        )
    return recording


def evaluate(
    result: Path | str,
    truth: Path | str | None = None,
    *,
    align: Literal["none", "rigid", "rigid+points", "similarity"] = "none",
    **options: Any,
) -> Evaluation:
    """Measure a result against truth, or by itself; same as ``posetrack eval``.

    Args:
        result: path of a result.
        truth: recording, result or CSV file with truth; None for the truth that the result carries.
        align: transform to remove before comparing.
        options: further fields of ``EvalOptions``, such as ``track="smoothed"``.

    Returns:
        ``metrics`` by address (``joint_error_mm.mean`` ...), and series per frame.

    Raises:
        PosetrackError: the result or the truth cannot be used, as one line.
    """
    from posetrack_cli.evaluation.measuring.evaluate import EvalOptions
    from posetrack_cli.evaluation.measuring.evaluate import evaluate as measure

    given = None if truth is None else Path(truth)
    return measure(Path(result), EvalOptions(truth=given, align=align, **options))


def _configured(kind: type[Model], files: Sequence[str | Path], settings: Mapping[str, Any]) -> Model:
    from posetrack_cli.configuration import find_configuration, load_settings

    return load_settings(kind, [find_configuration(str(file)) for file in files], settings)


def _as_list(config: str | Path | Sequence[str | Path]) -> list[str | Path]:
    return [config] if isinstance(config, str | Path) else list(config)


def _one_camera(camera: object) -> Camera:
    """Return the camera of arrays."""
    from posetrack_cli.geometry.camera import Camera

    if not isinstance(camera, Camera):
        expected = "posetrack.Camera(width, height, fx, fy, cx, cy)"
        raise UsageError("camera of the images is missing", found=repr(camera), expected=expected)
    return camera


def _check_unset(**given: object) -> None:
    """Refuse parameters that a recording has settled when it was opened."""
    for name, value in given.items():
        if value is not None:
            raise UsageError(f"{name} does not apply to an open recording", hint="pass it to open_recording")


def _camera_file(camera: object, stamps_ns: object) -> Path | None:
    """Return the camera file of a recording, which has its own stamps."""
    if stamps_ns is not None:
        raise UsageError("stamps_ns does not apply to a recording", hint="pass arrays, or leave it out")
    if camera is None or isinstance(camera, Path | str):
        return None if camera is None else Path(camera)
    raise UsageError("a recording takes a camera file", found=type(camera).__name__, expected="a path")


def _output(output: Path | str | None, *, smooth: bool, resume: bool) -> tuple[Path, ExitStack]:
    """Return where the result goes: the given path, or a temporary folder, which the stack deletes.

    While the stack is open, BLAS uses one thread, as on the command line: results would otherwise depend on
    the number of cores.
    """
    import scipy.linalg  # noqa: F401  loads scipy's own OpenBLAS, so that it is limited as well
    from threadpoolctl import threadpool_limits

    if output is None:
        for name, value in {"smooth": smooth, "resume": resume}.items():
            if value:
                raise UsageError(f"{name} needs a result file", hint="pass output=")
    folder = ExitStack()
    folder.enter_context(threadpool_limits(1, user_api="blas"))
    if output is not None:
        return Path(output), folder
    return Path(folder.enter_context(TemporaryDirectory(prefix="posetrack-"))) / _RESULT, folder


def _ignore(estimate: Estimate) -> None:
    """Accept an estimate of a first pass."""
