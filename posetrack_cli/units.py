"""Units at the borders: millimetres and integer nanoseconds inside, metres and seconds in many files."""

from __future__ import annotations

NS_PER_S = 1_000_000_000
METRES_PER_MM = 1e-3
