from __future__ import annotations

import os
from collections.abc import Iterator
from typing import Any

import pytest

from posetrack_cli.errors import RenderingError
from posetrack_cli.rendering.context import open_context


@pytest.fixture(scope="module")
def context() -> Iterator[Any]:
    """A context of this module's own: no other module can have made another one current meanwhile."""
    try:
        opened = open_context()
    except RenderingError as error:
        if os.environ.get("CI"):
            raise
        pytest.skip(f"nothing can be drawn here: {error}")
    yield opened
    opened.release()
