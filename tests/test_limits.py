"""The bounds in SECURITY.md are those of the module."""

from __future__ import annotations

import re
from pathlib import Path

from posetrack_cli import limits

ROOT = Path(__file__).parents[1]


def value_of(text: str) -> float:
    """A value as written in the table: ``1,000``, ``128 MiB`` or ``2^63 - 1``."""
    power, _, less = text.replace(",", "").removesuffix(" MiB").partition(" - ")
    base, _, exponent = power.partition("^")
    return (float(base) ** int(exponent or 1) - float(less or 0)) * (limits.MIB if "MiB" in text else 1)


def test_security_md_lists_every_bound_as_it_is() -> None:
    table = (ROOT / "SECURITY.md").read_text(encoding="utf-8").split("## Bounds", 1)[1]
    listed = {name: value_of(value) for name, value in re.findall(r"`(\w+)` \| ([^|]+) \|", table)}
    defined = {name: float(value) for name, value in vars(limits).items() if name.isupper() and name != "MIB"}
    assert listed == defined
