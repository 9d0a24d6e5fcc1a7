"""The bounds in SECURITY.md are those of the module."""

from __future__ import annotations

from pathlib import Path

from posetrack_cli import limits

ROOT = Path(__file__).parents[1]


def test_security_md_lists_every_bound_as_it_is() -> None:
    table = (ROOT / "SECURITY.md").read_text(encoding="utf-8").split("## Bounds", 1)[1]
    rows = [line.strip("| ").split(" | ") for line in table.splitlines() if line.startswith("| `")]
    listed = {name.strip("`"): float(bound.replace(",", "")) for name, bound in rows}
    defined = {name: float(value) for name, value in vars(limits).items() if name.isupper() and name != "MIB"}
    assert listed == defined
