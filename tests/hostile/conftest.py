from __future__ import annotations

import os
from collections.abc import Iterator

import pytest

from hostile.running import Harness, Pool
from hostile.seeds import Seeds, make_seeds


@pytest.fixture(scope="session")
def pool() -> Iterator[Pool]:
    """Two servers; one where other processes run tests beside this one, as each server imports everything."""
    with Pool(1 if "PYTEST_XDIST_WORKER" in os.environ else 2) as opened:
        yield opened


@pytest.fixture(scope="session")
def harness(pool: Pool) -> Harness:
    return pool.harnesses[0]


@pytest.fixture(scope="session")
def seeds(pool: Pool) -> Seeds:
    return make_seeds(pool)
