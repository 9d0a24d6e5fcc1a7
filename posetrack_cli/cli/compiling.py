"""What a user reads while a first run compiles."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def compiling_said() -> Iterator[None]:
    """Say on standard error, above any progress bar, that the fits are being compiled."""
    from tqdm import tqdm

    from posetrack_cli.compiled import announced

    with announced(lambda line: tqdm.write(f"{line} ...", file=sys.stderr)):
        yield
