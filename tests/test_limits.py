"""The bounds in SECURITY.md are those of the module."""

from __future__ import annotations

import re
from pathlib import Path

from posetrack_cli import limits

ROOT = Path(__file__).parents[1]


def test_security_md_lists_every_bound_as_it_is() -> None:
    table = (ROOT / "SECURITY.md").read_text(encoding="utf-8").split("## Bounds", 1)[1]
    cells = re.findall(r"`(\w+)` \| ([\d.,]+)( MiB)? \|", table)
    listed = {
        name: float(value.replace(",", "")) * (limits.MIB if unit else 1) for name, value, unit in cells
    }
    defined = {name: float(value) for name, value in vars(limits).items() if name.isupper() and name != "MIB"}
    assert listed == defined
