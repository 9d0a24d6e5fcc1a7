"""How well a hand result agrees with the images it was made from: no truth needed, and no truth either.

The hand's pixels are told from the rest of an image around the estimate itself
(``hand.segmentation``), so the figures are circular: they say that an estimate explains what is
near it, not that it is right. A hand mirrored or swapped in its fingers can score well; one that has left
the hand scores badly.
"""

from __future__ import annotations

from contextlib import closing

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.evaluation.matched_frames import matched_frames
from posetrack_cli.evaluation.recorded_hand import hand_of
from posetrack_cli.evaluation.recording_of import cameras_of
from posetrack_cli.evaluation.track import Track, track_of_result
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.config import ObservationSettings
from posetrack_cli.hand.inner import NO_THUMB, thumbs_of
from posetrack_cli.hand.kinematics import skinning_transforms
from posetrack_cli.hand.model import HandModel
from posetrack_cli.hand.observation import PixelSampler, window_around
from posetrack_cli.hand.segmentation import PredictedHand, segment
from posetrack_cli.losses import LossLog
from posetrack_cli.recording.base import Frame
from posetrack_cli.recording.recording import Recording
from posetrack_cli.rendering.devices import open_usual_device
from posetrack_cli.rendering.port import RenderingDevice
from posetrack_cli.rendering.sums import Comparison, TileSums
from posetrack_cli.results.reader import Result
from posetrack_cli.results.tracks import FILTERED

MESH_LEVEL = "fine"
WINDOW_MM = 320.0
"""A hand of scale 1 within ``reach_mm`` of its middle, whichever way it points, and some room."""
TILE_PX = 160
NO_CLAMP_MM = 1e6
"""Segmentation bounds the differences already."""


class HandConsistency:
    """Compares hands with images, one by one; the measure is the same for every run.

    Window and segmentation are the defaults, not the run's: results of different configurations are
    measured alike. Only the hand's side and size are the run's.

    Args:
        device: draws the hands.
        hand: bones and skin.
        camera: of the images; lens distortion is taken out.
    """

    def __init__(self, device: RenderingDevice, hand: HandModel, camera: Camera) -> None:
        self._anatomy, self._camera, self._sampler = hand.anatomy, camera, PixelSampler(camera)
        self._window = ObservationSettings(window_mm=WINDOW_MM * hand.anatomy.scale, tile_px=TILE_PX)
        mesh = hand.skin(MESH_LEVEL)
        self._renderer = device.depth_renderer(mesh, (TILE_PX, TILE_PX), 1)

    def compare(self, pose: FloatArray, frame: Frame, thumb: FloatArray = NO_THUMB) -> tuple[float, float]:
        """Return residual, mm (NaN where nothing is both), and overlap of a hand with a frame.

        Args:
            pose: (22,).
            frame: the image.
            thumb: (2,) its inner angles.
        """
        sums = self.sums(pose, frame, thumb)
        return residual_mm(sums), region_overlap(sums)

    def sums(self, pose: FloatArray, frame: Frame, thumb: FloatArray = NO_THUMB) -> TileSums:
        """Sums over the pixels of the window around a pose (22,) with inner angles of its thumb (2,)."""
        hand = PredictedHand.of(self._anatomy, pose, thumb)
        window = window_around(hand.joints, self._camera, self._window)
        observed = segment(frame.depth, self._sampler, window, self._camera, hand).observation
        transforms = skinning_transforms(self._anatomy, pose[None], thumb)
        return self._renderer.sums(transforms, self._camera, window, Comparison(observed.image, NO_CLAMP_MM))


def residual_mm(sums: TileSums) -> float:
    """Mean |rendered - observed| over the pixels of one tile that are both rendered and observed hand, mm.

    NaN where there is no such pixel; the overlap, 0, then says what is wrong.
    """
    both = float(sums.both[0])
    return float(sums.error[0]) / both if both else float("nan")


def region_overlap(sums: TileSums) -> float:
    """Intersection over union of rendered and observed hand: |r and o| / |r or o|, 0 to 1.

    Rendered pixels without a reading count on neither side: at a hand's edge most readings are missing, and
    what lies beyond the wrist is no hand. 0 where there is nothing at all.
    """
    both = float(sums.both[0])
    union = sums.observed + float(sums.rendered_only[0])
    return both / union if union else 0.0


def image_consistency(
    result: Result, recording: Recording, device: int | None = None, which: str = FILTERED
) -> dict[str, FloatArray]:
    """Metrics ``residual_mm`` and ``region_overlap`` of every frame (N,), lost ones included, NaN for none.

    Both are circular: the observed hand is told from the rest around the estimate. A frame that the recording
    does not give has neither; ``residual_mm`` has no value where estimate and observed hand share no pixel,
    and ``region_overlap`` is 0 there.

    Args:
        result: of a hand.
        recording: what it was made from (``search_recording``); every frame is read once.
        device: EGL device index, None for the default, or the processor without OpenGL.
        which: of its tracks.

    Returns:
        Nothing where the recording gives none of the result's frames, or the result has none.

    Raises:
        ResultError: the result is of another subject.
        UsageError: the images are not of the size that was tracked.
        RenderingError: nothing can be rendered here.
    """
    hand, track = hand_of(result), track_of_result(result, "", which)
    if not len(track):
        return {}
    (camera,) = cameras_of(result, recording)
    with closing(open_usual_device(device)) as drawing:
        residual, overlap = _compared(track, recording, HandConsistency(drawing, hand, camera)).T
    return {} if np.isnan(overlap).all() else {"residual_mm": residual, "region_overlap": overlap}


def _compared(track: Track, recording: Recording, measure: HandConsistency) -> FloatArray:
    """Residual and overlap (N, 2) of every frame, NaN where the recording does not give it."""
    compared = np.full((len(track), 2), np.nan)
    if track.position is None or track.quaternion is None or track.shape is None:
        return compared
    poses = np.hstack([track.position, track.quaternion, track.shape])
    thumbs = thumbs_of(track.numbers, len(track))
    for row, frame in matched_frames(recording, track.stamp_ns, track.frame_index, LossLog()):
        compared[row] = measure.compare(poses[row], frame, thumbs[row])
    return compared
