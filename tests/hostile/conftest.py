from __future__ import annotations

from collections.abc import Iterator

import pytest

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
