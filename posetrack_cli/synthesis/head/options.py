"""What a synthetic recording of a head is made of."""

from __future__ import annotations

from dataclasses import dataclass

from posetrack_cli.synthesis.recording import check_option

MOTIONS = ("natural", "slight", "turn", "still")
FREE, TWO_MOTIONS = "free", "two-motions"
SCRIPTS = (FREE, TWO_MOTIONS)
LIGHTS = ("slow", "sudden", "steady")
CAMERAS = (1, 2)
MOST_FRAMES = 1_000_000
SIZES_PX = (64, 4096)
DISTANCES_MM = (350.0, 3000.0)
BASELINES_MM = (20.0, 400.0)


@dataclass(frozen=True)
class HeadSynthOptions:
    """A synthetic recording of a head: the same options give the same frames on the same machine.

    Attributes:
        cameras: 1, or 2 that are toed in to meet at the head's first place.
        identity: seed of the person.
        frames: number of frames.
        fps: frame rate, Hz.
        seed: of everything random but the person.
        expressions: whether the face deforms; whether it blinks and looks around.
        script: how it deforms: ``free`` makes all expressions, in the first two thirds; ``two-motions`` only
            those that models of faces are built from, mouth in width and face in length.
        motion: ``natural`` wandering of the head; ``slight`` a fifth of it, facing the camera; ``turn`` also
            two sudden turns; ``still`` none.
        speed: factor on the rate of the natural motion's time.
        light: ``slow`` drift, also a lamp switched in the middle (``sudden``), or ``steady``.
        occlusion: whether an object covers half the face for one second.
        noise: factor on the sensor's noise.
        distortion: whether the lenses distort.
        drops: whether cameras now and then miss images.
        width, height: of the images, pixels; the horizontal field of view is always the same.
        distance_mm: of the head from the reference camera in the beginning.
        baseline_mm: between two cameras.

    Raises:
        UsageError: a value that cannot be meant.
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
            "script", self.script, self.expressions or self.script == FREE, "a face with expressions"
        )
        check_option("light", self.light, self.light in LIGHTS, " or ".join(LIGHTS))
        check_option("camera-count", self.cameras, self.cameras in CAMERAS, "1 or 2")
        for name in ("identity", "seed"):
            check_option(name, getattr(self, name), getattr(self, name) >= 0, "0 or more")
        ranges = {
            "frames": (self.frames, 1, MOST_FRAMES),
            "fps": (self.fps, 1.0, 1000.0),
            "speed": (self.speed, 0.1, 10.0),
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
        """From the first to the last frame's stamp."""
        return (self.frames - 1) / self.fps
