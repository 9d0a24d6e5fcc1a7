"""Options of synthetic hand recordings."""

from __future__ import annotations

from dataclasses import dataclass, field, fields

import numpy as np

from posetrack_cli.hand.config import SIDES
from posetrack_cli.hand.model.anatomy import (
    COEFFICIENTS,
    FINGERS,
    MOST_COEFFICIENT,
    MOST_PADDING_MM,
    SHAPE_NAMES,
    HandShape,
    PerFinger,
    random_shape,
)
from posetrack_cli.hand.model.hand import HandModel, hand_maker
from posetrack_cli.synthesis.hand.sensors import KINECT_2, SENSORS
from posetrack_cli.synthesis.recording import check_option

MOTIONS = ("A", "B", "C")
SCALES = (0.5, 1.5)
"""Smallest and largest hand, which stay in the image throughout the motion region."""
PROPORTIONS = (0.7, 1.4)
PLACES = (0.5, 2.5)
SPEEDS = (0.01, 100.0)
MOST_FRAMES = 1_000_000


@dataclass(frozen=True)
class Switches:
    """Additions to the bare hand.

    Attributes:
        noise: Gaussian noise, and missing readings outside the sensor's range.
        edges: missing readings at depth edges.
        background: a room behind the hand.
        body: torso and head behind the hand; with ``forearm`` also the upper arm.
        forearm: the forearm.
        drops: missing frames.
        late: late frames.
    """

    noise: bool = False
    edges: bool = False
    background: bool = False
    body: bool = False
    forearm: bool = False
    drops: bool = False
    late: bool = False

    @classmethod
    def all_on(cls) -> Switches:
        """Return switches for a realistic recording."""
        return cls(**dict.fromkeys(SWITCH_NAMES, True))

    @classmethod
    def usual(cls, motion: str) -> Switches:
        """Return the default: everything for natural motion C, nothing for the paper's motions A and B."""
        return cls.all_on() if motion == "C" else cls()


SWITCH_NAMES = tuple(switch.name for switch in fields(Switches))


@dataclass(frozen=True)
class SynthOptions:
    """Options of a synthetic recording; equal options give equal frames.

    Attributes:
        motion: ``A`` pose random walk, eq. (66); ``B`` pose and velocity random walk, eq. (67); ``C``
            smooth natural motion.
        frames: number of instants at the nominal rate, including dropped frames.
        seed: random seed.
        speed: factor on the noise of A and B, or on the rate of time of C. 0.01 to 100.
        side: ``right`` or ``left``.
        scale: factor on the hand's lengths, 0.5 to 1.5.
        finger_lengths, finger_widths, palm_width, palm_length, palm_thickness, wrist_width, thumb_place:
            see ``HandShape``; each factor 0.7 to 1.4.
        coefficients: see ``HandShape``; must be empty with ``mesh``.
        padding_mm: see ``HandShape``; 0 to 12.
        mesh: GLB file of the hand; None for a hand from the population model.
        fps: nominal frame rate, Hz.
        sensor: ``kinect2`` or one of ``SENSORS``.
        switches: additions to the bare hand.

    Raises:
        UsageError: invalid value.
    """

    motion: str = "C"
    frames: int = 300
    seed: int = 0
    speed: float = 1.0
    side: str = "right"
    scale: float = 1.0
    finger_lengths: PerFinger = (1.0, 1.0, 1.0, 1.0, 1.0)
    finger_widths: PerFinger = (1.0, 1.0, 1.0, 1.0, 1.0)
    palm_width: float = 1.0
    palm_length: float = 1.0
    palm_thickness: float = 1.0
    wrist_width: float = 1.0
    thumb_place: float = 1.0
    coefficients: tuple[float, ...] = ()
    padding_mm: float = 0.0
    mesh: str | None = None
    fps: float = 30.0
    sensor: str = KINECT_2
    switches: Switches = field(default_factory=Switches.all_on)

    def __post_init__(self) -> None:
        check_option("motion", self.motion, self.motion in MOTIONS, " or ".join(MOTIONS))
        check_option("side", self.side, self.side in SIDES, " or ".join(SIDES))
        check_option("frames", self.frames, 1 <= self.frames <= MOST_FRAMES, f"1 to {MOST_FRAMES}")
        sensors = (KINECT_2, *SENSORS)
        check_option("sensor", self.sensor, self.sensor in sensors, " or ".join(sensors))
        check_option("seed", self.seed, self.seed >= 0, "0 or more")
        check_option("fps", self.fps, 1.0 <= self.fps <= 1000.0, "1 to 1000")
        low, high = SPEEDS
        check_option("speed", self.speed, low <= self.speed <= high, f"{low:g} to {high:g}")
        self._check_shape()

    def _check_shape(self) -> None:
        for name, value in zip(SHAPE_NAMES, self.shape.factors, strict=True):
            low, high = {"scale": SCALES, "thumb_place": PLACES}.get(name, PROPORTIONS)
            of_finger = name.endswith(("_length", "_width")) and name.split("_")[0] in FINGERS
            option = "finger_" + name.split("_")[1] + "s" if of_finger else name
            good = bool(low <= value <= high)
            check_option(option.replace("_", "-"), f"{value:g}", good, f"{low:g} to {high:g}")
        most = MOST_PADDING_MM
        check_option("padding-mm", f"{self.padding_mm:g}", 0.0 <= self.padding_mm <= most, f"0 to {most:g}")
        self._check_coefficients()

    def _check_coefficients(self) -> None:
        count, most = len(self.coefficients), MOST_COEFFICIENT
        check_option("coefficients", count, count <= COEFFICIENTS, f"{COEFFICIENTS} or less")
        for value in self.coefficients:
            check_option("coefficients", f"{value:g}", abs(value) <= most, f"{-most:g} to {most:g}")
        alone = self.mesh is None or not self.coefficients
        check_option("hand-mesh", self.mesh, alone, "no shape coefficients together with a mesh")

    @property
    def shape(self) -> HandShape:
        """Size and proportions of the hand."""
        return HandShape(**{f.name: getattr(self, f.name) for f in fields(HandShape)})

    def hand(self) -> HandModel:
        """Return the hand model.

        Raises:
            UsageError: ``mesh`` is not a usable hand.
        """
        return hand_maker(self.mesh)(self.side, self.shape)


def hand_of_seed(seed: int) -> HandShape:
    """Return the random hand of a seed, from a stream independent of motion and sensor."""
    return random_shape(np.random.default_rng(seed).spawn(4)[3])
