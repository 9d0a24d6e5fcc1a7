"""Calibration of a recording's hand: track it, choose frames, adjust its shape; twice.

No truth is used. The first time the hand is tracked with an average shape; the second time with that which
was found, so that frames count that could not be tracked before.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path

import numpy as np

from posetrack_cli.arrays import FloatArray, IntArray
from posetrack_cli.errors import RecordingError
from posetrack_cli.files import write_output
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.calibration.bundle import Bundle, adjusted
from posetrack_cli.hand.calibration.sequence import SequenceFit, SequenceFitter
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.hand.fitting.fitter import nearest_pixels
from posetrack_cli.hand.fitting.terms import Terms, Tile
from posetrack_cli.hand.model import HandMaker, HandModel, hand_maker
from posetrack_cli.hand.observer import Observer
from posetrack_cli.hand.shape import SHAPE_NAMES, HandShape
from posetrack_cli.outputs import whole_or_nothing
from posetrack_cli.recording.base import Frame
from posetrack_cli.recording.recording import Recording
from posetrack_cli.rendering.raster import View

SIDES = ("right", "left")
TRIED_SCALES = (0.78, 0.88, 1.0, 1.13, 1.28)
TRIAL_FRAMES = 24
ROUNDS = 2
NS_PER_S = 10**9
_FEWEST_FRAMES = 4
_ROTATION_WEIGHT = 2.0  # of a quaternion's distance beside angles, rad

Report = Callable[[str], None]
_DECIMALS = 4  # of the factors in a hand file


@dataclass(frozen=True)
class CalibrationOptions:
    """What a calibration depends on besides recording and configuration.

    Attributes:
        side: ``right`` or ``left``; None to find out.
        seconds: length of the part of the recording that is used, from its start.
        frames: how many frames the shape is adjusted to.
        seed: of the scattered starts of fits.
        start: the first frame that is used.
    """

    side: str | None = None
    seconds: float = 5.0
    frames: int = 16
    seed: int = 0
    start: int = 0


@dataclass(frozen=True, eq=False)
class Calibration:
    """What a calibration found.

    Attributes:
        side: ``right`` or ``left``.
        shape: of the hand.
        sd: (16,) standard deviations of the factors.
        frames_seen: frames that were tracked.
        frames_used: frames that the shape was adjusted to.
        residual_mm: weighted root mean square of their residuals.
    """

    side: str
    shape: HandShape
    sd: FloatArray
    frames_seen: int
    frames_used: int
    residual_mm: float


def calibrate(
    recording: Recording, config: HandConfig, options: CalibrationOptions, report: Report = lambda line: None
) -> Calibration:
    """Estimate side, size and proportions of the hand in a recording.

    Args:
        recording: depth frames.
        config: of window, segmentation and fits; of its hand only the mesh is read.
        options: the rest.
        report: called with what is being done.

    Raises:
        RecordingError: no frame, or no hand that can be tracked in at least four frames.
        UsageError: the configuration's mesh is no hand that can be used.
    """
    frames = _first_seconds(recording, options.seconds, options.start)
    maker, camera = hand_maker(config.hand.mesh), recording.cameras[0]
    calibrator = _Calibrator(config, camera, maker, recording.path, options)
    report("which hand, and about how large")
    side, shape = calibrator.best_start(frames)
    for attempt in range(ROUNDS):
        report(f"tracking the {side} hand, {attempt + 1} of {ROUNDS}")
        fitted = calibrator.fit(frames, side, shape)
        chosen = calibrator.chosen(fitted)
        report(f"adjusting its shape to {len(chosen)} frames")
        bundle = calibrator.adjust([frames[k] for k in chosen], fitted.poses[chosen], side, shape)
        shape = bundle.shape
    sd = shape.factors * np.sqrt(np.diag(bundle.covariance))
    return Calibration(side, shape, sd, len(frames), len(chosen), bundle.residual_mm)


def _first_seconds(recording: Recording, seconds: float, start: int = 0) -> list[Frame]:
    frames = recording.frames(start=start, end=None, stride=1)
    first = next(frames, None)
    if first is None:
        raise RecordingError("holds no frame", where=recording.path)
    last = first.stamp_ns + int(seconds * NS_PER_S)
    return [first, *takewhile(lambda frame: frame.stamp_ns <= last, frames)]


class _Calibrator:
    """The parts of a calibration."""

    def __init__(
        self, config: HandConfig, camera: Camera, maker: HandMaker, path: Path, options: CalibrationOptions
    ) -> None:
        self._config, self._camera, self._maker, self._path = config, camera, maker, path
        self._options = options

    def best_start(self, frames: Sequence[Frame]) -> tuple[str, HandShape]:
        """The side and scale with which the first frames are tracked at the least mean cost."""
        sides = (self._options.side,) if self._options.side else SIDES
        tried = {}
        for side in sides:
            for scale in TRIED_SCALES:
                fitted = self.fit(frames[:TRIAL_FRAMES], side, HandShape(scale=scale))
                clamped = np.minimum(fitted.costs, self._config.observation.clamp_mm)
                tried[side, scale] = float(clamped.mean())
        side, scale = min(tried, key=lambda key: tried[key])
        return side, HandShape(scale=scale)

    def fit(self, frames: Sequence[Frame], side: str, shape: HandShape) -> SequenceFit:
        """The poses of a hand in frames."""
        fitter = SequenceFitter(self._config, self._maker(side, shape), self._camera)
        return fitter.fit(frames, np.random.default_rng(self._options.seed))

    def chosen(self, fitted: SequenceFit) -> IntArray:
        """Frames that fit well and differ in pose.

        Raises:
            RecordingError: there are too few.
        """
        found = fitted.costs[np.isfinite(fitted.costs)]
        few = np.sort(found)[: max(_FEWEST_FRAMES, -(-found.size // 2))]  # a hand upside down fits worse
        limit = float(few[-1]) if few.size else 0.0
        good = np.flatnonzero(fitted.costs <= limit)
        if good.size < _FEWEST_FRAMES:
            raise RecordingError(
                "no hand that can be tracked",
                where=self._path,
                found=f"{good.size} of {len(fitted.costs)} frames",
                expected=f"{_FEWEST_FRAMES} or more",
                hint="choose a recording, or with --seconds a part, that shows one hand well",
            )
        return good[spread(fitted.poses[good], self._options.frames)]

    def adjust(self, frames: Sequence[Frame], poses: FloatArray, side: str, shape: HandShape) -> Bundle:
        """The shape and the poses that fit the frames best."""
        return adjusted(
            self._maker,
            side,
            shape,
            poses,
            self._observing(frames),
            self._config.observation.tile_px,
            terms=_terms(self._config),
        )

    def _observing(self, frames: Sequence[Frame]) -> Callable[[int, FloatArray, HandModel], Tile]:
        def observe(f: int, pose: FloatArray, hand: HandModel) -> Tile:
            observer = Observer(self._config, hand.anatomy, self._camera, segment=True)
            observation = observer.observe(frames[f].depth, pose)
            image = observation.image.astype(np.float64)
            view = View(*observation.window.tile_projection(self._camera))
            return Tile(image, nearest_pixels(image > 0), observation.target_pixels, view, observation.arm)

        return observe


def _terms(config: HandConfig) -> Terms:
    """The residuals' weights with the configuration's clamp."""
    return Terms()._replace(
        clamp_mm=config.observation.clamp_mm, unread_weight=config.observation.unread_weight
    )


def spread(poses: FloatArray, count: int) -> IntArray:
    """Indices of at most ``count`` poses (N, 22) far from each other in angles and orientation, in order.

    Each is the farthest from those chosen before it (Gonzalez 1985); quaternions count by |q . q'|.
    """
    chosen = [0]
    nearest = np.full(len(poses), np.inf)
    while len(chosen) < min(count, len(poses)):
        last = poses[chosen[-1]]
        turned = 1.0 - np.abs(poses[:, 3:7] @ last[3:7])
        angles = np.linalg.norm(poses[:, 7:] - last[7:], axis=1)
        nearest = np.minimum(nearest, angles + _ROTATION_WEIGHT * turned)
        chosen.append(int(nearest.argmax()))
    return np.array(sorted(set(chosen)))


def write_hand_file(path: Path, calibration: Calibration, mesh: str | None, source: str) -> None:
    """Write a TOML file that ``--config`` reads beside others.

    Args:
        path: the file.
        calibration: side and shape.
        mesh: the GLB file that the shape is of, None for the average hand.
        source: name of the recording, for the comment.

    Raises:
        ResultError: it cannot be written.
    """
    with whole_or_nothing(path) as part:
        write_output(part, hand_text(calibration, mesh, source, path.parent).encode())


def hand_text(calibration: Calibration, mesh: str | None, source: str, folder: Path) -> str:
    """The file's text; a mesh is named relative to the file's folder where it lies in it, else in full."""
    shape = calibration.shape
    sd = dict(zip(SHAPE_NAMES, calibration.sd.tolist(), strict=True))
    lines = [
        f"# Calibrated from {json.dumps(source)}: {calibration.frames_used} frames,"
        f" residual {calibration.residual_mm:.2f} mm. Standard deviations beside the numbers.",
        "[hand]",
        f'side = "{calibration.side}"',
        f"scale = {_number(shape.scale)}  # {sd['scale']:.3f}",
        f"finger_lengths = {_row(shape.finger_lengths)}  # {_deviations(sd, 'length')}",
        f"finger_widths = {_row(shape.finger_widths)}  # {_deviations(sd, 'width')}",
        *(f"{name} = {_number(getattr(shape, name))}  # {sd[name]:.3f}" for name in SHAPE_NAMES[11:]),
    ]
    if mesh is not None:
        lines.append(f"mesh = {json.dumps(_reachable(Path(mesh), folder))}")
    return "\n".join(lines) + "\n"


def _reachable(mesh: Path, folder: Path) -> str:
    mesh, folder = mesh.resolve(), folder.resolve()
    return str(mesh.relative_to(folder) if mesh.is_relative_to(folder) else mesh)


def _deviations(sd: dict[str, float], what: str) -> str:
    fingers = [value for name, value in sd.items() if name.endswith(what) and not name.startswith("palm")]
    return " ".join(f"{value:.3f}" for value in fingers)


def _row(values: tuple[float, ...]) -> str:
    return f"[{', '.join(map(_number, values))}]"


def _number(value: float) -> str:
    return f"{value:.{_DECIMALS}f}"
