"""Agreement of hand results with the depth images.

The observed hand is segmented around the estimate (``hand.observe.segmentation``), so these metrics are
circular: they show that the estimate explains the nearby depth, not that it is correct. A mirrored hand or
swapped fingers can score well; an estimate that has left the hand scores badly.
"""

from __future__ import annotations

from contextlib import closing

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.evaluation.reading.recording_of import cameras_of, hand_of
from posetrack_cli.evaluation.reading.tracks import Track, matched_frames, track_of_result
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.config import ObservationSettings
from posetrack_cli.hand.fit.skeleton import NO_THUMB, thumbs_of
from posetrack_cli.hand.model.hand import HandModel
from posetrack_cli.hand.model.kinematics import skinning_transforms
from posetrack_cli.hand.observe.observation import PixelSampler, window_around
from posetrack_cli.hand.observe.prediction import PredictedHand
from posetrack_cli.hand.observe.segmentation import segment
from posetrack_cli.losses import LossLog
from posetrack_cli.recording.base import Frame
from posetrack_cli.recording.recording import Recording
from posetrack_cli.rendering.devices import open_usual_device
from posetrack_cli.rendering.port import Comparison, RenderingDevice, TileSums
from posetrack_cli.results.reader import Result
from posetrack_cli.results.topics import FILTERED

MESH_LEVEL = "fine"
WINDOW_MM = 320.0
"""Size of the image window at scale 1: fits the hand in any orientation, with a margin."""
TILE_PX = 160
NO_CLAMP_MM = 1e6
"""No clamping of depth differences, as segmentation already bounds them."""


class HandConsistency:
    """Compares hand poses with depth images.

    Uses the default window and segmentation settings rather than those of the run, so that results of
    different configurations are comparable. Only side and size of the hand are taken from the run.

    Args:
        device: rendering device.
        hand: hand model.
        camera: camera of the images; lens distortion is compensated.
    """

    def __init__(self, device: RenderingDevice, hand: HandModel, camera: Camera) -> None:
        self._anatomy, self._camera, self._sampler = hand.anatomy, camera, PixelSampler(camera)
        self._window = ObservationSettings(window_mm=WINDOW_MM * hand.anatomy.scale, tile_px=TILE_PX)
        mesh = hand.skin(MESH_LEVEL)
        self._renderer = device.depth_renderer(mesh, (TILE_PX, TILE_PX), 1)

    def compare(self, pose: FloatArray, frame: Frame, thumb: FloatArray = NO_THUMB) -> tuple[float, float]:
        """Return ``residual_mm`` (NaN without overlap) and ``region_overlap`` of a hand in a frame.

        Args:
            pose: (22,) hand pose.
            frame: frame with the depth image.
            thumb: (2,) inner angles of the thumb.
        """
        sums = self.sums(pose, frame, thumb)
        return residual_mm(sums), region_overlap(sums)

    def sums(self, pose: FloatArray, frame: Frame, thumb: FloatArray = NO_THUMB) -> TileSums:
        """Return the comparison sums over the pixels of the window around a pose; see ``compare``."""
        hand = PredictedHand.of(self._anatomy, pose, thumb)
        window = window_around(hand.joints, self._camera, self._window)
        observed = segment(frame.depth, self._sampler, window, self._camera, hand).observation
        transforms = skinning_transforms(self._anatomy, pose[None], thumb)
        return self._renderer.sums(transforms, self._camera, window, Comparison(observed.image, NO_CLAMP_MM))


def residual_mm(sums: TileSums) -> float:
    """Return the mean |rendered - observed|, mm, over the pixels of both the rendered and the observed hand.

    NaN without such a pixel; the overlap is 0 then.
    """
    both = float(sums.both[0])
    return float(sums.error[0]) / both if both else float("nan")


def region_overlap(sums: TileSums) -> float:
    """Return the intersection over union of rendered and observed hand, |r and o| / |r or o|, 0 to 1.

    Rendered pixels without a depth reading are ignored, as most readings at the edge of a hand are missing.
    0 if there are no pixels.
    """
    both = float(sums.both[0])
    union = sums.observed + float(sums.rendered_only[0])
    return both / union if union else 0.0


def image_consistency(
    result: Result, recording: Recording, device: int | None = None, which: str = FILTERED
) -> dict[str, FloatArray]:
    """Return ``residual_mm`` and ``region_overlap`` of all frames (N,), including lost ones.

    Both are NaN in frames that the recording does not have. Without common pixels, ``residual_mm`` is NaN and
    ``region_overlap`` is 0.

    Args:
        result: result of a hand.
        recording: recording of the result (``search_recording``); each frame is read once.
        device: EGL device index; None for the default device, or the CPU without OpenGL.
        which: name of the track.

    Returns:
        An empty dictionary if the result is empty or the recording has none of its frames.

    Raises:
        ResultError: the result is of another subject.
        UsageError: the image size differs from that of the run.
        RenderingError: no renderer is available.
    """
    hand, track = hand_of(result), track_of_result(result, "", which)
    if not len(track):
        return {}
    (camera,) = cameras_of(result, recording)
    with closing(open_usual_device(device)) as drawing:
        residual, overlap = _compared(track, recording, HandConsistency(drawing, hand, camera)).T
    return {} if np.isnan(overlap).all() else {"residual_mm": residual, "region_overlap": overlap}


def _compared(track: Track, recording: Recording, measure: HandConsistency) -> FloatArray:
    """Return residual and overlap (N, 2) of all frames, NaN for frames that the recording does not have."""
    compared = np.full((len(track), 2), np.nan)
    if track.position is None or track.quaternion is None or track.shape is None:
        return compared
    poses = np.hstack([track.position, track.quaternion, track.shape])
    thumbs = thumbs_of(track.numbers, len(track))
    for row, frame in matched_frames(recording, track.stamp_ns, track.frame_index, LossLog()):
        compared[row] = measure.compare(poses[row], frame, thumbs[row])
    return compared
