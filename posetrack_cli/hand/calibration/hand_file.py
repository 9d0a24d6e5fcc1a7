"""A calibrated hand as a configuration file with a ``[hand]`` table."""

from __future__ import annotations

import json
from pathlib import Path

from posetrack_cli.files import write_output
from posetrack_cli.hand.calibration.calibrate import Calibration
from posetrack_cli.hand.shape import SHAPE_NAMES
from posetrack_cli.outputs import whole_or_nothing

_DECIMALS = 4


def write_hand_file(path: Path, calibration: Calibration, mesh: str | None, source: str) -> None:
    """Write a TOML file that ``--config`` reads beside others.

    Args:
        path: the file.
        calibration: side and shape.
        mesh: the GLB file that the shape is of, None for the average hand.
        source: name of the recording, for the comment.

    Raises:
        ResultError: it cannot be written.
    """
    with whole_or_nothing(path) as part:
        write_output(part, hand_text(calibration, mesh, source, path.parent).encode())


def hand_text(calibration: Calibration, mesh: str | None, source: str, folder: Path) -> str:
    """The file's text; a mesh is named relative to the file's folder where it lies in it, else in full."""
    shape = calibration.shape
    sd = dict(zip(SHAPE_NAMES, calibration.sd.tolist(), strict=True))
    lines = [
        f"# Calibrated from {json.dumps(source)}: {calibration.frames_used} frames,"
        f" residual {calibration.residual_mm:.2f} mm. Standard deviations beside the numbers.",
        "[hand]",
        f'side = "{calibration.side}"',
        f"scale = {_number(shape.scale)}  # {sd['scale']:.3f}",
        f"finger_lengths = {_row(shape.finger_lengths)}  # {_deviations(sd, 'length')}",
        f"finger_widths = {_row(shape.finger_widths)}  # {_deviations(sd, 'width')}",
        *(f"{name} = {_number(getattr(shape, name))}  # {sd[name]:.3f}" for name in SHAPE_NAMES[11:]),
    ]
    if mesh is not None:
        lines.append(f"mesh = {json.dumps(_reachable(Path(mesh), folder))}")
    return "\n".join(lines) + "\n"


def _reachable(mesh: Path, folder: Path) -> str:
    mesh, folder = mesh.resolve(), folder.resolve()
    return str(mesh.relative_to(folder) if mesh.is_relative_to(folder) else mesh)


def _deviations(sd: dict[str, float], what: str) -> str:
    fingers = [value for name, value in sd.items() if name.endswith(what) and not name.startswith("palm")]
    return " ".join(f"{value:.3f}" for value in fingers)


def _row(values: tuple[float, ...]) -> str:
    return f"[{', '.join(map(_number, values))}]"


def _number(value: float) -> str:
    return f"{value:.{_DECIMALS}f}"
