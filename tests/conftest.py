from __future__ import annotations

import gc
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

from posetrack_cli.errors import RenderingError
from posetrack_cli.rendering.cpu import CpuDevice
from posetrack_cli.rendering.gl.device import GlDevice
from posetrack_cli.rendering.port import RenderingDevice
from support.numpy_renderer import NumpyDevice

pytest_plugins = ["support.recordings"]

LONGEST = (
    "tests/hostile/",
    "docs/test_snippets.py",
    "cli/test_batch.py",
    "hand/test_calibration.py",
    "cli/test_hand_run.py",
    "cli/test_head_mono.py",
    "cli/test_head_stereo.py",
    "evaluation/test_html_browser.py",
    "cli/test_hand_calibrate.py",
    "cli/test_eval.py",
    "cli/test_hand_keypoints.py",
    "recording/calibration/test_stereo.py",
    "hand/test_recovery.py",
)
"""Begun first, in this order; all others as they are found."""

# As in a process of the command line.
gc.set_threshold(20_000)

# The same examples in every run: a red run means a change. HYPOTHESIS_PROFILE=random looks for new ones.
# 40 of them: what breaks a law is among the first few, and the same search again finds nothing new.
# No deadline: a machine with much to do is no error.
settings.register_profile("same", derandomize=True, deadline=None, max_examples=40)
settings.register_profile("random", derandomize=False, deadline=None)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "same"))


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Hand out whole files, as their tests share what fixtures made; all hostile ones share servers."""
    from xdist.scheduler import LoadScopeScheduling

    class WholeFiles(LoadScopeScheduling):
        def _split_scope(self, nodeid: str) -> str:
            path = nodeid.split("::")[0]
            return "tests/hostile" if path.startswith("tests/hostile/") else path

    return WholeFiles(config, log)


class Backwards(pytest.Dir):
    """A folder of which the last file is read first."""

    def collect(self) -> list[pytest.Item | pytest.Collector]:
        return list(super().collect())[::-1]


def pytest_collect_directory(path: Path, parent: pytest.Collector) -> pytest.Collector | None:
    """Let every other process read the tests from the end: each compiles half, and finds what others did.

    Where nothing is kept yet, to compile them takes longer than to read them, assertions above all.
    """
    worker = os.environ.get("PYTEST_XDIST_WORKER", "gw0")
    odd = int(worker.removeprefix("gw")) % 2 == 1
    return Backwards.from_parent(parent, path=path) if odd and not (path / "__init__.py").exists() else None


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Let the longest files begin, so that no process is left with one at the end; alike in every process."""

    def turn(item: pytest.Item) -> tuple[int, Path]:
        first = next((k for k, part in enumerate(LONGEST) if part in item.nodeid), len(LONGEST))
        return first, item.path

    items.sort(key=turn)


def pytest_collection_finish() -> None:
    """What was read stays: Python need not look through it again and again for what may go."""
    gc.freeze()


@pytest.fixture(scope="session")
def measured_data() -> Path:
    """The folder of real and realistic recordings beside the project; tests that need it skip without."""
    folder = Path(__file__).parents[2] / "shared" / "data"
    if not folder.is_dir():
        pytest.skip("measured recordings are not on this machine")
    return folder


@pytest.fixture(scope="module")
def gl_device() -> Iterator[GlDevice]:
    """A device of this module's own: no other module can have made another context current meanwhile."""
    try:
        opened = GlDevice()
    except RenderingError as error:
        if os.environ.get("CI"):
            raise
        pytest.skip(f"nothing can be drawn here: {error}")
    yield opened
    opened.close()


@pytest.fixture(scope="module")
def device(gl_device: GlDevice) -> RenderingDevice:
    """What draws."""
    return gl_device


@pytest.fixture(scope="module", params=["OpenGL", "processor"])
def fast_device(request: pytest.FixtureRequest) -> RenderingDevice:
    """What a run may draw depth with."""
    return CpuDevice() if request.param == "processor" else request.getfixturevalue("gl_device")


@pytest.fixture(scope="module", params=["OpenGL", "processor", "numpy"])
def any_device(request: pytest.FixtureRequest) -> RenderingDevice:
    """Every implementation of the renderers' port in turn."""
    known = {"numpy": NumpyDevice, "processor": CpuDevice}
    return known[request.param]() if request.param in known else request.getfixturevalue("gl_device")


@pytest.fixture(scope="module", params=["OpenGL", "numpy"])
def reference_device(request: pytest.FixtureRequest) -> RenderingDevice:
    """OpenGL, and its reference in numpy: what draws surfaces, too, and what crosses the near plane."""
    return NumpyDevice() if request.param == "numpy" else request.getfixturevalue("gl_device")
