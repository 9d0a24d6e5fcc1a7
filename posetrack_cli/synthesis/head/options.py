"""Options of synthetic head recordings."""

from __future__ import annotations

from dataclasses import dataclass

from posetrack_cli.synthesis.recording import check_option

MOTIONS = ("natural", "slight", "turn", "still")
FREE, TWO_MOTIONS = "free", "two-motions"
SCRIPTS = (FREE, TWO_MOTIONS)
LIGHTS = ("slow", "sudden", "steady")
MOST_CAMERAS = 4
MOST_FRAMES = 1_000_000
SIZES_PX = (64, 4096)
DISTANCES_MM = (350.0, 3000.0)
BASELINES_MM = (20.0, 400.0)
YAW_RANGES_DEG = (0.0, 90.0)
ROLLS_DEG = (-180.0, 180.0)


@dataclass(frozen=True)
class HeadSynthOptions:
    """Options of a synthetic head recording; equal options give equal frames on the same machine.

    Attributes:
        cameras: 1, or up to 4 that converge at the head's initial position.
        identity: seed of the person.
        frames: number of frames.
        fps: frame rate, Hz.
        seed: seed of everything except the person.
        expressions: whether the face deforms, blinks and looks around.
        script: deformations: ``free`` has all expressions, in the first two thirds; ``two-motions`` only
            those that face models are built from, mouth width and face length.
        motion: ``natural`` head motion; ``slight`` a fifth of it, facing the camera; ``turn`` additionally
            two sudden turns; ``still`` none.
        speed: factor on the rate of time of the natural motion.
        yaw_range: largest yaw of the natural motion to either side, deg.
        roll: rotation of the person in the image, deg, clockwise; trunk included, cameras and light not.
        light: ``slow`` drift; ``sudden``, additionally a lamp switched in the middle; or ``steady``.
        occlusion: whether an object covers half the face for one second.
        noise: factor on the sensor noise.
        distortion: whether the lenses have distortion.
        drops: whether cameras occasionally miss images.
        width, height: image size, pixels; the horizontal field of view is fixed.
        distance_mm: initial distance of the head from the reference camera.
        baseline_mm: distance of the other cameras from the first.

    Raises:
        UsageError: invalid value.
    """

    cameras: int = 2
    identity: int = 1
    frames: int = 600
    fps: float = 30.0
    seed: int = 0
    expressions: bool = True
    script: str = FREE
    motion: str = "natural"
    speed: float = 1.0
    yaw_range: float = 26.0
    roll: float = 0.0
    light: str = "slow"
    occlusion: bool = False
    noise: float = 1.0
    distortion: bool = False
    drops: bool = False
    width: int = 640
    height: int = 480
    distance_mm: float = 700.0
    baseline_mm: float = 120.0

    def __post_init__(self) -> None:
        check_option("motion", self.motion, self.motion in MOTIONS, " or ".join(MOTIONS))
        check_option("script", self.script, self.script in SCRIPTS, " or ".join(SCRIPTS))
        check_option(
            "script", self.script, self.expressions or self.script == FREE, "expressions to be enabled"
        )
        check_option("light", self.light, self.light in LIGHTS, " or ".join(LIGHTS))
        check_option("camera-count", self.cameras, 1 <= self.cameras <= MOST_CAMERAS, f"1 to {MOST_CAMERAS}")
        for name in ("identity", "seed"):
            check_option(name, getattr(self, name), getattr(self, name) >= 0, "0 or more")
        ranges = {
            "frames": (self.frames, 1, MOST_FRAMES),
            "fps": (self.fps, 1.0, 1000.0),
            "speed": (self.speed, 0.1, 10.0),
            "yaw-range": (self.yaw_range, *YAW_RANGES_DEG),
            "roll": (self.roll, *ROLLS_DEG),
            "noise-factor": (self.noise, 0.0, 20.0),
            "distance-mm": (self.distance_mm, *DISTANCES_MM),
            "baseline-mm": (self.baseline_mm, *BASELINES_MM),
        }
        for name, (value, low, high) in ranges.items():
            check_option(name, value, low <= value <= high, f"{low:g} to {high:g}")
        low, high = SIZES_PX
        good = low <= min(self.width, self.height) and max(self.width, self.height) <= high
        check_option("image-size", f"{self.width}x{self.height}", good, f"sides of {low} to {high} pixels")

    @property
    def duration_s(self) -> float:
        """Time from the first to the last frame."""
        return (self.frames - 1) / self.fps
