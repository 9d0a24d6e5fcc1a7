"""Small recordings with annotated joints, as ``research.cvar`` reads them."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from research import cvar


def annotated(names: list[str]) -> str:
    """Joint k of the file at pixel (100 + k, 50 + 2 k), 500 + k mm away."""
    cells = " ".join(f"{100 + k:.3f} {50 + 2 * k:.3f} {500 + k:.3f}" for k in range(21))
    return "\n".join([str(len(names)), *(f"./CVAR/P9/{name} {cells} " for name in names)]) + "\n"


def make_folder(path: Path, frames: int = 3, width: int = 321) -> Path:
    path.mkdir()
    names = [f"{index:06d}_depth.png" for index in range(frames)]
    for index, name in enumerate(names):
        image = np.full((240, width), 600 + index, dtype=np.uint16)
        image[0, 0] = cvar.MISSING
        image[:, 320:] = 7
        assert cv2.imwrite(str(path / name), image)
    (path / "joint.txt").write_text(annotated(names))
    return path
