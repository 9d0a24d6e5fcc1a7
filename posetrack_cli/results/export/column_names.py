"""What the columns of an exported table are called; a truth in CSV is read by the same names."""

from __future__ import annotations

from collections.abc import Iterable

from posetrack_cli.results.estimate import Subject

HEAD = "head"
POSITION = ("x_mm", "y_mm", "z_mm")
QUATERNION = ("qx", "qy", "qz", "qw")
LINEAR_VELOCITY = ("vx_mm_s", "vy_mm_s", "vz_mm_s")
ANGULAR_VELOCITY = ("wx_rad_s", "wy_rad_s", "wz_rad_s")


def point_columns(names: Iterable[str]) -> tuple[str, ...]:
    """Return three columns for each point, in mm."""
    return tuple(f"{name}_{axis}_mm" for name in names for axis in "xyz")


def shape_unit(subject: Subject) -> str:
    """Return the unit of the shape entries: a head's are coefficients without one, all others angles."""
    return "" if subject.name == HEAD else "rad"


def shape_columns(subject: Subject, *suffixes: str) -> tuple[str, ...]:
    """Return a column for each shape entry: its name, suffixes (such as ``sd``), its unit if it has one."""
    return tuple(
        "_".join(filter(None, (name, *suffixes, shape_unit(subject)))) for name in subject.shape_names
    )


def rate_columns(subject: Subject, *suffixes: str) -> tuple[str, ...]:
    """Return a column for the rate of each shape entry, ``..._rad_s`` or ``..._per_s``."""
    unit = shape_unit(subject) or "per"
    return tuple("_".join((name, *suffixes, unit, "s")) for name in subject.shape_names)
