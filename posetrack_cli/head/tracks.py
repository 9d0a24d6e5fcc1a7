"""How heads move, and what tracks of them are wrong by, for each tracker **[ours]**."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.head.config import HeadMonoConfig, HeadStereoConfig
from posetrack_cli.head.face.points import of_kinds
from posetrack_cli.tracking.velocity import VelocityModel


@dataclass(frozen=True, eq=False)
class TrackModel:
    """What one of the trackers is known to do.

    Attributes:
        systematic_sd: (6,) what a whole track is wrong by, alike in all frames, so that no particle tells: mm
            in camera axes and rad about the head's axes. It comes from where a person's points are taken to
            be in the head, and is part of the variances that a result states.
        velocity: of the six entries of a head's pose, for the velocity that a result states.
        deformation: for smoothing, how many of their standard deviations the deformations explain; 0 is none.
        expression_mm: (K,) for smoothing, how far expressions move points in addition to that.
    """

    systematic_sd: FloatArray
    velocity: VelocityModel
    deformation: float
    expression_mm: FloatArray


def _six(position: float, rotation: float) -> FloatArray:
    return np.repeat([position, rotation], 3)


START_SD = _six(200.0, 2.0)
"""Of a head's velocity where a track begins, mm/s and rad/s: as of a hand's."""

STEREO = TrackModel(
    # root mean squares over twelve rendered people
    systematic_sd=np.concatenate([[2.6, 2.3, 3.3], np.radians([2.3, 1.8, 1.4])]),
    velocity=VelocityModel(_six(40.0, 0.5), _six(0.1, 0.001), START_SD),
    # several cameras measure points, and learn deformations from few frames
    deformation=0.0,
    expression_mm=of_kinds(eyes=0.3, mouth=5.0, nostrils=1.0, brows=2.0),
)
MONO = TrackModel(
    # chosen on twelve people, ten of whom were tracked with what was learned from the others
    systematic_sd=np.concatenate([[1.0, 1.0, 3.0], np.radians([1.7, 1.1, 0.45])]),
    velocity=VelocityModel(_six(90.0, 0.8), _six(0.3, 0.003), START_SD),
    deformation=1.0,
    expression_mm=of_kinds(eyes=0.5, mouth=1.2, nostrils=0.9, brows=1.5),
)


def track_model(config: HeadStereoConfig | HeadMonoConfig) -> TrackModel:
    """Return that of the tracker which a configuration is for."""
    return MONO if isinstance(config, HeadMonoConfig) else STEREO
