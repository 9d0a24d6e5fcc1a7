from __future__ import annotations

import sys
from pathlib import Path

HERE = Path(__file__).parent
for folder in (
    HERE,
    HERE.parent / "evaluation",
    HERE.parent / "results",
    HERE.parent / "head" / "multilinear",
    HERE.parent / "recording",
    HERE.parent / "recording" / "calibration",
):  # their support modules are shared by the tests of this folder
    sys.path.insert(0, str(folder))
