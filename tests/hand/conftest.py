from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

import pytest

from posetrack_cli.errors import RenderingError
from posetrack_cli.rendering.context import open_context

sys.path.insert(0, str(Path(__file__).parent))  # hand_support is shared by the tests of this folder


@pytest.fixture(scope="module")
def context() -> Any:
    """A context of this module's own: no other module can have made another one current meanwhile."""
    try:
        return open_context()
    except RenderingError as error:
        if os.environ.get("CI"):
            raise
        pytest.skip(f"nothing can be drawn here: {error}")
