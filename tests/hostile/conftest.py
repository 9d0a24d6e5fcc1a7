from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[1]))  # hostile is a package

from hostile.running import Harness, Pool
from hostile.seeds import Seeds, make_seeds


@pytest.fixture(scope="session")
def pool() -> Iterator[Pool]:
    with Pool() as opened:
        yield opened


@pytest.fixture(scope="session")
def harness(pool: Pool) -> Harness:
    return pool.harnesses[0]


@pytest.fixture(scope="session")
def seeds(pool: Pool) -> Seeds:
    return make_seeds(pool)
