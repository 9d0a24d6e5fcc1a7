"""Unit factors: millimetres and integer nanoseconds inside, metres and seconds in many file formats."""

from __future__ import annotations

NS_PER_S = 1_000_000_000
METRES_PER_MM = 1e-3
