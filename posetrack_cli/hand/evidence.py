"""Diagnosis of depth images in which few or no frames were tracked."""

from __future__ import annotations

from collections.abc import Sequence
from math import atan, degrees

import numpy as np

from posetrack_cli.hand.config import HandConfig
from posetrack_cli.hand.observe.detection import Detection, detect
from posetrack_cli.recording.base import Frame
from posetrack_cli.recording.camera_of import principal_point_fault
from posetrack_cli.recording.depth import (
    MM_PER_M,
    content_of,
    length_words,
    likely_units,
    range_words,
    unit_mm_of,
)
from posetrack_cli.recording.recording import Recording

NARROWEST_DEG, WIDEST_DEG = 15.0, 150.0
"""Plausible fields of view of depth cameras; common ones have 40 to 120 degrees."""
_MANY = 0.5
"""Share of frames with a hand-like region above which the hand is present but does not fit."""


_ALL_PIXELS = 0.9999
"""Share of valid pixels above which images are not depth: that lacks readings at edges and in shadows."""


class DepthEvidence:
    """Evidence from some frames of a recording.

    Args:
        recording: the recording.
        config: of the run.
        frames: some of its frames.
    """

    def __init__(self, recording: Recording, config: HandConfig, frames: Sequence[Frame]) -> None:
        self._camera, self._config, self._frames = recording.cameras[0], config, frames
        self._unit_mm = unit_mm_of(recording.pixels[0])
        self.content = content_of((frame.depth for frame in frames), self._camera)
        self._hands = [detect(frame.depth, self._camera, config.detection) for frame in frames]

    @property
    def line(self) -> str:
        """Return a summary, with the likeliest reason if there is one."""
        return f"{self.seen}{f'; {self.reason}' if self.reason else ''}"

    @property
    def seen(self) -> str:
        """Return how many frames show a hand-like region, at which depths and of what size."""
        if not self.content.images:
            return f"no reading in {len(self._frames)} sampled frames"
        found = [hands for hands in self._hands if hands]
        where = f"depths {self.content.range_words(1.0)}"
        if not found:
            size = f"nearest surface {length_words(self.content.surface)} across"
            return f"no hand-like region in {len(self._frames)} sampled frames; {where}, {size}"
        palms: list[Detection] = [hand for hands in found for hand in hands]
        depths = np.percentile([float(hand.palm[2]) for hand in palms], (10, 90))
        radius = float(np.median([hand.palm_radius_mm for hand in palms]))
        at = f"at {range_words(float(depths[0]), float(depths[1]))}"
        of = f"{len(found)} of {len(self._frames)} sampled frames"
        return f"hand-like region in {of}, {at}, palm radius {radius:.0f} mm; {where}"

    @property
    def reason(self) -> str:
        """Return the likeliest reason and the option to change; empty without evidence."""
        if not self.content.images:
            return ""
        return self._of_camera or self._of_unit or self._of_hand or self._of_brightness

    @property
    def is_in_range(self) -> bool:
        """Return whether some depths are in the search range."""
        low, high = self._config.detection.nearest_mm, self._config.detection.farthest_mm
        return bool(self.content.images) and self.content.near <= high and self.content.far >= low

    @property
    def _of_camera(self) -> str:
        camera = self._camera
        size = f"{camera.width}x{camera.height}"
        fault = principal_point_fault(camera)
        if fault is not None:
            where = f"({camera.cx:.0f}, {camera.cy:.0f}) in {size}"
            return f"the principal point is {fault}, {where}; set --camera to the camera of these images"
        angle = degrees(2.0 * atan(0.5 * camera.width / camera.fx))
        if NARROWEST_DEG <= angle <= WIDEST_DEG:
            return ""
        view = f"a focal length of {camera.fx:.0f} px means a field of view of {angle:.0f} degrees"
        return f"{view} at {size}; set --camera to the camera of these images"

    @property
    def _of_unit(self) -> str:
        content, detection = self.content, self._config.detection
        units = likely_units(content, self._unit_mm)
        if self._unit_mm in units and self.is_in_range:
            return ""
        known = f"depth was read as {self._unit_mm:g} mm per stored unit"
        fitting = " or ".join(f"{unit:g}" for unit in units)
        if not self.is_in_range:
            low, high = detection.nearest_mm / MM_PER_M, detection.farthest_mm / MM_PER_M
            searched = f"hands are searched from {low:g} to {high:g} m"
            advice = f"--depth-unit-mm {fitting} would fit" if units else "set --depth-unit-mm"
            return f"{searched}, but {known}; {advice}"
        if units and not any(self._hands):
            size = f"the nearest surface is {length_words(content.surface)} across"
            return f"{size}, and {known}; with --depth-unit-mm {fitting} it would have the size of a hand"
        return ""

    @property
    def _of_brightness(self) -> str:
        if self.content.share < _ALL_PIXELS:
            return ""
        return "every pixel has a value, which is unusual for depth; are these infrared images?"

    @property
    def _of_hand(self) -> str:
        hand = self._config.hand
        if sum(map(bool, self._hands)) < _MANY * max(1, len(self._hands)):
            return ""
        stated = [f"a {hand.side} hand (--hand-side)"] if hand.side != "auto" else []
        stated += [f"of scale {hand.scale:g} (--scale)"] if hand.scale != 1.0 else []
        assumed = " ".join(stated) or "the average hand"
        return f"they do not fit {assumed}, or the intrinsics belong to another image"
