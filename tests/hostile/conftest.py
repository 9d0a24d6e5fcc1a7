from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[1]))  # hostile is a package

from hostile.running import Harness
from hostile.seeds import Seeds, make_seeds, warm_up


@pytest.fixture(scope="session")
def harness() -> Iterator[Harness]:
    with Harness() as opened:
        yield opened


@pytest.fixture(scope="session")
def seeds(harness: Harness) -> Seeds:
    made = make_seeds(harness)
    warm_up(harness, made)
    return made
