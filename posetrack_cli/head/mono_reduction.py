"""The one-camera tracker on images of the size that its patches are made for **[ours]**.

Patches have 16 x 16 pixels, which the thesis chose for faces whose eyes are some 60 to 90 pixels apart. Of
a face that fills a large image they show a piece of a lid: a blink or a smile changes all of it. Such images
are reduced once the face was first found. Poses are in millimetres and do not change.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.head.mono_start.detected import eye_distance_px
from posetrack_cli.head.mono_state import MonoState
from posetrack_cli.head.mono_tracker import MonoTracker
from posetrack_cli.head.person_codec import unusable_people
from posetrack_cli.recording.base import Frame
from posetrack_cli.results.estimate import Estimate
from posetrack_cli.results.layouts import floats
from posetrack_cli.tracking.state_codec import Codec, Fields, Value

LEAST_REDUCTION = 0.8
"""Images that would become hardly smaller stay as they are."""
_WHOLE, _FOCAL = 1.0, "focal_px"
_LEAST_SCALE = 1e-6

MakeTracker = Callable[[Camera, float, Mapping[str, np.ndarray[Any, Any]] | None], MonoTracker]
"""Makes the tracker for a camera whose images were reduced by a factor, with what another has learned."""


@dataclass(frozen=True, eq=False)
class ReducedState:
    """What the tracker knows after a frame.

    Attributes:
        scale: 1 for images as recorded, less for reduced ones; None before a face is first found.
        inner: of the tracker on those images.
    """

    scale: float | None
    inner: MonoState


class ReducingTracker:
    """A ``MonoTracker`` on images that are reduced to where faces are as large as its patches ask for.

    Args:
        camera: of the recording.
        eye_distance_px: between the eyes of a face; larger faces are reduced to it.
        make: the tracker for a camera.
        known: what another tracker has ``learned``.

    Raises:
        ResultError: ``known`` holds no focal length that was learned at.
        PosetrackError: whatever ``make`` refuses.
    """

    def __init__(
        self,
        camera: Camera,
        eye_distance_px: float,
        make: MakeTracker,
        known: Mapping[str, np.ndarray[Any, Any]] | None = None,
    ) -> None:
        self._camera, self._eye_distance, self._make = camera, eye_distance_px, make
        self._trackers: dict[float, MonoTracker] = {}
        self._known, self._first_scale = known or None, _known_scale(known, camera)
        self._at(self._first_scale or _WHOLE)  # refuses what cannot be used before the first frame

    @property
    def codec(self) -> Codec[ReducedState]:
        """How states are kept; that of the inner one does not depend on the scale."""
        known = floats(least=_LEAST_SCALE, most=_WHOLE, missing=True)
        scale = Value(known, lambda stored: None if np.isnan(stored) else float(stored))
        return Fields(
            ReducedState,
            scale=(lambda state: np.nan if state.scale is None else state.scale, scale),
            inner=self._at(_WHOLE).codec,
        )

    def start(self, frame: Frame, rng: np.random.Generator) -> ReducedState:
        """Return the state before a first frame, in which the head has yet to be found."""
        scale = self._first_scale
        if scale is None:  # clicked points tell how large the face is
            scale = self._scale_of(self._at(_WHOLE).start(frame, rng))
        return ReducedState(scale, self._at(scale or _WHOLE).start(frame, rng))

    def step(
        self, state: ReducedState, frame: Frame, rng: np.random.Generator
    ) -> tuple[ReducedState, Estimate]:
        """Advance by one frame; the state given is left as it is."""
        if state.scale is not None:
            inner, estimate = self._at(state.scale).step(state.inner, reduced(frame, state.scale), rng)
            return ReducedState(state.scale, inner), estimate
        inner, estimate = self._at(_WHOLE).step(state.inner, frame, rng)
        scale = self._scale_of(inner)
        if scale is None or scale == _WHOLE:
            return ReducedState(scale, inner), estimate
        small = reduced(frame, scale)
        tracker = self._at(scale)
        inner, estimate = tracker.step(
            replace(tracker.start(small, rng), search=state.inner.search), small, rng
        )
        return ReducedState(scale, inner), estimate

    def _scale_of(self, inner: MonoState) -> float | None:
        """The scale for the face that was found in a whole image; None where none was found yet."""
        distance = inner.eye_distance
        if distance is None and inner.following is not None:  # found in one frame, so not waited for more
            distance = eye_distance_px(inner.following.pose, self._camera)
        if distance is None:
            return None
        scale = self._eye_distance / distance
        return _WHOLE if scale > LEAST_REDUCTION else scale

    def learned(self, state: ReducedState) -> dict[str, np.ndarray[Any, Any]]:
        """Return what was learned of the people seen, and how large they were seen."""
        learned = self._of(state).learned(state.inner)
        focal = (state.scale or _WHOLE) * self._camera.fx
        return learned | ({_FOCAL: np.array(focal)} if learned else {})

    def not_found(self, state: ReducedState) -> str:
        """Say how a head was looked for that was found in no frame yet; empty once it was found."""
        return self._of(state).not_found(state.inner)

    def remarks(self, state: ReducedState) -> tuple[str, ...]:
        """Say what a user should know about a finished run beside its numbers."""
        return self._of(state).remarks(state.inner)

    def _of(self, state: ReducedState) -> MonoTracker:
        """The tracker of a state's scale; of whole images before a face is first found."""
        return self._at(state.scale or _WHOLE)

    def _at(self, scale: float) -> MonoTracker:
        if scale not in self._trackers:
            self._trackers[scale] = self._make(reduced_camera(self._camera, scale), scale, self._known)
        return self._trackers[scale]


def reduced(frame: Frame, scale: float) -> Frame:
    """Return a frame with its image reduced; as it is for a scale of 1."""
    (image,) = frame.images
    if scale == _WHOLE or image is None:
        return frame
    height, width = (_length(side, scale) for side in image.shape)
    return replace(frame, images=(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA),))


def reduced_camera(camera: Camera, scale: float) -> Camera:
    """Return the camera of reduced images: pixel u is at (u + 1/2) w'/w - 1/2."""
    if scale == _WHOLE:
        return camera
    width, height = _length(camera.width, scale), _length(camera.height, scale)
    across, down = width / camera.width, height / camera.height
    return replace(
        camera,
        width=width,
        height=height,
        fx=camera.fx * across,
        fy=camera.fy * down,
        cx=(camera.cx + 0.5) * across - 0.5,
        cy=(camera.cy + 0.5) * down - 0.5,
    )


def reduced_pixels(pixels: FloatArray, scale: float) -> FloatArray:
    """Return where pixels (..., 2) are after a reduction, to a thousandth of the image."""
    return pixels if scale == _WHOLE else (pixels + 0.5) * scale - 0.5


def _length(side: int, scale: float) -> int:
    return max(round(side * scale), 1)


def _known_scale(known: Mapping[str, np.ndarray[Any, Any]] | None, camera: Camera) -> float | None:
    """The scale at which a learned face was seen; None if none was learned, ResultError for a damaged one."""
    if known is None or _FOCAL not in known:
        return None
    focal = known[_FOCAL]
    if focal.dtype.kind != "f" or focal.shape != () or not 0.0 < focal < np.inf:
        raise unusable_people(f"'{_FOCAL}' as {focal.dtype} {focal.shape}, or not above 0")
    return min(_WHOLE, float(focal) / camera.fx)
