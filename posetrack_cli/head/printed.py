"""Where a run differs from Sugano's thesis: chapter 3 of several cameras, chapter 4 of one."""

from __future__ import annotations

from posetrack_cli.head.config import HeadMonoConfig, HeadStereoConfig, PointSettings
from posetrack_cli.tracking.printed import Deviation, PrintedSetting, deviations

ALIKE = PointSettings(eyes=1.0, mouth=1.0, nostrils=1.0, brows=1.0)
BOTH = (
    PrintedSetting("3.3.2", "particles.sampling", "printed"),
    PrintedSetting("3.3.1", "particles.resampling", "multinomial"),
    PrintedSetting("(3.28)", "particles.lookup", "nearest"),
    PrintedSetting("(3.29)", "refinement.joint", False),
    PrintedSetting("3.2.3, 4.4.3", "refinement.recalculation", "printed"),
    PrintedSetting("(3.5)", "refinement.rho", 4.0),
    PrintedSetting("3.2.1", "refinement.keyframe_deg", 360.0),
    PrintedSetting("3.4, 4.5", "run.passes", 1),
)
STEREO = (
    PrintedSetting("3.2.1", "model.components", 5),
    PrintedSetting("3.4", "model.rigid_frames", 120),
    PrintedSetting("3.4, (3.20)", "model.rigid_phase", "printed"),
    PrintedSetting("3.2.3", "model.expression_mm", ALIKE),
    PrintedSetting("3.2.4", "model.correlation", 0.0),
    PrintedSetting("3.4", "particles.count", 1000),
    PrintedSetting("(3.27)", "particles.weighting", "printed"),
    PrintedSetting("(3.27)", "particles.sigma", 3.0),
    PrintedSetting("3.3.1", "particles.kappa", 0.5),
    PrintedSetting("(3.3)", "refinement.epsilon", 2000.0),
    PrintedSetting("3.2.2", "refinement.settling_mm", 0.01),
)
MONO = (
    PrintedSetting("4.4.1", "start.frames", 5),
    PrintedSetting("4.5", "start.eye_distance_px", 1000.0),
    PrintedSetting("4.5", "start.largest_scale", 1.0),
    PrintedSetting("(4.18)", "start.pixel_sd", 1.0),
    PrintedSetting("4.5", "particles.count", 750),
    PrintedSetting("(4.41)", "particles.weighting", "printed"),
    PrintedSetting("(4.41)", "particles.sigma", 1.0),
    PrintedSetting("4.4.2", "particles.kappa", 0.2),
    PrintedSetting("(4.42)", "refinement.epsilon", 4000.0),
    PrintedSetting("(4.43)", "refinement.previous_likeness", 0.0),
    PrintedSetting("4.3.2", "adjustment.views", 5),
    PrintedSetting("4.3.2", "adjustment.spread", "angles"),
    PrintedSetting("4.5", "adjustment.iterations", 5),
    PrintedSetting("4.5", "adjustment.start_iterations", 10),
    PrintedSetting("(4.36)", "adjustment.average", 15),
    PrintedSetting("(4.35), (4.37)", "adjustment.bound", 2.0),
    PrintedSetting("(4.18)", "adjustment.prior", 0.0),
    PrintedSetting("(4.18)", "adjustment.offsets", False),
    PrintedSetting("(4.18)", "adjustment.huber", 1e6),
    PrintedSetting("(4.18)", "adjustment.pixel_sd", ALIKE),
    PrintedSetting("4.4.3", "adjustment.neutral_mm", 1e6),
    PrintedSetting("4.4.3", "adjustment.gates_points", True),
    PrintedSetting("3.2.1", "skin.use", False),
    PrintedSetting("4.4", "status.check_below", 0.0),
)
ALWAYS_BOTH = (
    Deviation("3.2.1", "templates are warped to the predicted pose"),
    Deviation("(3.28)", "points weigh less where they are turned away from the camera"),
    Deviation("(3.26)", "rotations move by rotation vectors, not by angles"),
    Deviation("(3.31)", "the velocity in results is estimated from the poses up to the next frame's"),
    Deviation("(3.29)", "motion noise and the radius d are ours; none are printed"),
    Deviation("3.3", "a frame may be lost (status); the face is then searched for"),
)
ALWAYS_STEREO = (
    Deviation("3.2.2", "OpenCV's detector finds face and points, not OKAO Vision"),
    Deviation("(3.18), (3.19)", "the factor 2 of (3.16) is kept"),
    Deviation("3.2.4", "a shape far from a face's is not learnt from"),
    Deviation("(3.24)", "the basis is made orthogonal after every update"),
    Deviation("3.2.3, 3.2.4", "angle and distances of the gates are ours; none are printed"),
)
ALWAYS_MONO = (
    Deviation("4.4.1", "learned responses find face and points, not OKAO Vision"),
    Deviation("4.4.1", "the adjustment begins with each frame's own pose, not in the middle of the image"),
    Deviation("(4.21) to (4.24)", "the signs of the normal equations are corrected"),
    Deviation("(4.37)", "the box is about s, not about a"),
    Deviation("(4.51), (4.52)", "the factor 2 is that of both terms"),
    Deviation("4.4.3", "the score is the estimate's mean correlation, not the best particle's"),
    Deviation("4.3, 4.4.3", "boxes, angle and score are ours; none are printed"),
)
SHIPPED_MODEL = Deviation("4.2", "the shipped face model is learned from ICT-FaceKit")


def deviations_from_print(config: HeadStereoConfig | HeadMonoConfig) -> list[str] | None:
    """Return where a configuration that follows the thesis differs from it; None of any other.

    It follows the thesis where the particles' weights (3.27), (4.41) are the thesis's, and their estimate is
    the pose.
    """
    if config.particles.weighting != "printed" or config.refinement.joint:
        return None
    if isinstance(config, HeadStereoConfig):
        return deviations(config, (*STEREO, *BOTH), (*ALWAYS_STEREO, *ALWAYS_BOTH))
    model = (SHIPPED_MODEL,) if config.model.file is None else ()
    return deviations(config, (*MONO, *BOTH), (*model, *ALWAYS_MONO, *ALWAYS_BOTH))
