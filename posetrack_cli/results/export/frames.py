"""Results as pandas and xarray objects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np

from posetrack_cli.errors import UsageError
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.results.columns import Columns
from posetrack_cli.results.derived import JOINT_ANGLES, MEANINGS, PIXELS, UNITS, joint_angle_names
from posetrack_cli.results.estimate import Subject
from posetrack_cli.results.export.table import table_of
from posetrack_cli.results.fields import BY_NAME, NUMBERS

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

_POSE = ("x", "y", "z", "qx", "qy", "qz", "qw")
_TANGENT = ("x", "y", "z", "rx", "ry", "rz")
_DIMENSIONS = {
    "position": ("axis",),
    "quaternion": ("component",),
    "shape": ("parameter",),
    "pose_rate": ("pose",),
    "twist": ("tangent",),
    "pose_variance": ("tangent",),
    "twist_variance": ("tangent",),
    "points": ("point", "axis"),
    PIXELS: ("camera", "point", "pixel"),
    JOINT_ANGLES: ("angle",),
}
"""Dimensions of each array after ``frame``."""


def to_pandas(columns: Columns, subject: Subject, cameras: Sequence[Camera]) -> pd.DataFrame:
    """Return one row per frame, indexed by ``stamp_ns``; columns as in exported CSV files.

    Raises:
        UsageError: pandas is not installed.
    """
    pandas = _module("pandas")
    data: dict[str, Any] = {}
    for group in table_of(subject, cameras):
        data |= dict(zip(group.names, group.values(columns).T, strict=True))
    index = pandas.Index(data.pop("stamp_ns"), name="stamp_ns")
    frame: pd.DataFrame = pandas.DataFrame(data, index=index)
    frame["status"] = frame["status"].astype("category")
    return frame


def to_xarray(
    columns: Columns, subject: Subject, cameras: Sequence[Camera], run: Mapping[str, str]
) -> xr.Dataset:
    """Return a dataset with dimension ``frame`` and labelled axes, parameters and points.

    Variables are the arrays of ``Result.to_numpy`` and the tracker's additional numbers; each array has its
    ``units`` and ``long_name``. The attributes of the dataset are the run record.

    Raises:
        UsageError: xarray is not installed.
    """
    xarray = _module("xarray")
    variables: dict[str, Any] = {}
    for name, values in columns.items():
        if name == NUMBERS:
            continue
        if name in UNITS:
            unit, meaning = UNITS[name], MEANINGS[name]
        else:
            field = BY_NAME[name]
            unit, meaning = field.unit or (field.meaning if field.shape else ""), field.description
        about = {"units": unit, "long_name": meaning}
        variables[name] = (("frame", *_DIMENSIONS.get(name, ())), values, about)
    if NUMBERS in columns:
        numbers = zip(subject.number_names, columns[NUMBERS].T, strict=True)
        variables |= {name: (("frame",), values) for name, values in numbers}
    labels = {
        "axis": ("x", "y", "z"),
        "component": ("x", "y", "z", "w"),
        "parameter": subject.shape_names,
        "pose": (*_POSE, *subject.shape_names),
        "tangent": (*_TANGENT, *subject.shape_names),
        "point": subject.point_names,
        "camera": tuple(camera.name for camera in cameras),
        "pixel": ("u", "v"),
        "angle": joint_angle_names(subject),
    }
    used = {dimension for name in columns for dimension in _DIMENSIONS.get(name, ())}
    coordinates = {name: np.array(labels[name], dtype=str) for name in labels if name in used}
    stamp = {"stamp_ns": variables.pop("stamp_ns")}
    dataset: xr.Dataset = xarray.Dataset(variables, coords=coordinates | stamp, attrs=dict(run))
    return dataset


def _module(name: str) -> Any:
    """Import an optional dependency."""
    try:
        return import_module(name)
    except ImportError as error:
        raise UsageError(f"{name} is not installed", found=error, hint=f"pip install {name}") from error
