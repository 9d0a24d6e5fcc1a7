"""What the page calls figures and parts."""

from __future__ import annotations

from posetrack_cli.evaluation.metrics.catalogue import metric_of

_UNIT_ENDINGS = ("_deg_s", "_mm_s", "_mm", "_deg", "_s")
_SPOKEN = {
    "ess": "effective sample size",
    "evaluations": "poses evaluated",
    "nees": "NEES",
    "velocity_nees": "velocity NEES",
    "ms_per_frame": "time per frame",
    "frames_per_s": "frame rate",
    "inside_90": "inside 90 % interval",
    "velocity_inside_90": "velocity inside 90 % interval",
    "wrist_position_mm": "wrist position error",
    "wrist_rotation_deg": "wrist rotation error",
    "position_mm": "position error",
    "rotation_deg": "rotation error",
    **{f"{axis}_mm": f"{axis} error" for axis in ("x", "y", "z")},
    **{f"{angle}_deg": f"{angle} error" for angle in ("roll", "pitch", "yaw")},
}


def readable(name: str) -> str:
    """Return a name with spaces."""
    return name.replace("_", " ")


def quantity_label(address: str) -> tuple[str, str]:
    """Return what a metric's address is called, and its unit: ``joint error, index tip`` and ``mm``."""
    name, _, part = address.partition(".")
    label = _spoken(name)
    return (f"{label}, {readable(part)}" if part else label), metric_of(name).unit


def _spoken(name: str) -> str:
    if name in _SPOKEN:
        return _SPOKEN[name]
    if name.startswith("frames_within_"):
        return readable(name).replace("mm", " mm")
    endings = (name.removesuffix(ending) for ending in _UNIT_ENDINGS if name.endswith(ending))
    return readable(next(endings, name))
