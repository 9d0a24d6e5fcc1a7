"""Where a run differs from the hand paper (Kajihara and Tanaka)."""

from __future__ import annotations

from posetrack_cli.hand.config import HandConfig
from posetrack_cli.tracking.printed import Deviation, PrintedSetting, deviations

SETTINGS = (
    PrintedSetting("7.2.1", "filter.particles", 512),
    PrintedSetting("(51)", "filter.proposal", "paper"),
    PrintedSetting("(44)", "filter.discretisation", "euler"),
    PrintedSetting("(56)", "filter.gain", "printed"),
    PrintedSetting("(44), (62)", "filter.rotations", "additive"),
    PrintedSetting("A.1", "filter.joint_limits", False),
    PrintedSetting("6 (7)", "filter.resampling", "multinomial"),
    PrintedSetting("6 (7)", "filter.ess_threshold", 1.0),
    PrintedSetting("(4)", "observation.cost", "paper"),
    PrintedSetting("(47)", "observation.likelihood", "gaussian"),
    PrintedSetting("(64)", "observation.sigma_mm", 20.0),
    PrintedSetting("(65)", "observation.clamp_mm", 100.0),
    PrintedSetting("7.1", "observation.window_px", 128),
    PrintedSetting("7.1", "observation.tile_px", 128),
    PrintedSetting("7.3", "init.method", "center"),
    PrintedSetting("(63)", "velocity.method", "filter"),
)
ALWAYS = (
    Deviation("A.1", "the thumb turns about z at joint 3 (CMC), not at joint 2"),
    Deviation("(44)", "quaternions are scaled to length 1, and noise along them is left out"),
    Deviation("4.2", "R lies about the predicted hand, not about the last estimate"),
    Deviation("5.3", "a frame without readings moves particles by the motion alone"),
    Deviation("(45)", "a step counts as motion.gap_max_s at most"),
    Deviation("7.3", "a frame may be lost (status)"),
    Deviation("(45), (46)", "noise densities are ours; none are printed"),
)


def deviations_from_print(config: HandConfig) -> list[str] | None:
    """Return where a configuration that follows the paper differs from it; None of any other.

    It follows the paper where cost (4) and proposal (51) are the paper's.
    """
    if config.observation.cost != "paper" or config.filter.proposal != "paper":
        return None
    return deviations(config, SETTINGS, ALWAYS)
