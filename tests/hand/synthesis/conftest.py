from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from posetrack_cli.rendering.context import open_context


@pytest.fixture(scope="module")
def context() -> Iterator[Any]:
    opened = open_context()
    yield opened
    opened.release()
