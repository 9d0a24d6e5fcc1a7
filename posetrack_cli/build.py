"""Build identity: the sources, libraries and CPU features that a result depends on.

Runs with the same recording, options, seed and build identity write identical bytes. The CPU affects only
last digits: OpenBLAS, numpy and OpenCV select code paths by its features. Compiled kernels do not depend on
it (``compiled``: no fastmath).
"""

from __future__ import annotations

import hashlib
import os
from functools import cache
from pathlib import Path

PACKAGE = Path(__file__).parent
_LIBRARIES = (
    "av",
    "fast-simplification",
    "lz4",
    "mcap",
    "numba",
    "numpy",
    "opencv-python-headless",
    "protobuf",
    "scipy",
    "zstandard",
)
"""Distributions that decode, compute or encode; another version may change results or bytes."""
_DIGITS = 16
_EVERYTHING = ("**/*",)
_NOT_INSTALLED = "0+unknown"


@cache
def version() -> str:
    """Return the installed version: last tag, number of commits since then, and commit hash."""
    return _version_of("posetrack")


@cache
def source_digest(patterns: tuple[str, ...] = _EVERYTHING, root: Path = PACKAGE) -> str:
    """Return a short digest of the names and contents of the package's files.

    It is computed once per process, so it keeps describing the running code if files change later.

    Args:
        patterns: glob patterns of the files; default: all files, including the shipped configurations.
        root: package folder.
    """
    files = {path.relative_to(root).as_posix(): path for one in patterns for path in root.glob(one)}
    if patterns == _EVERYTHING and not (root / "configs").is_dir():
        configs = root.parent / "configs"  # in a checkout, configs/ lies next to the package
        files |= {path.relative_to(root.parent).as_posix(): path for path in configs.rglob("*.toml")}
    digest = hashlib.sha256()
    for name, path in sorted(files.items()):
        if "__pycache__" not in path.parts and path.is_file():
            content = path.read_bytes()
            digest.update(f"{name}\0{len(content)}\0".encode() + content)
    return digest.hexdigest()[:_DIGITS]


def build_name() -> str:
    """Return version and source digest as readable text."""
    return f"{version()} (sources {source_digest()})"


@cache
def libraries() -> str:
    """Return names and versions of the libraries that results depend on."""
    return ", ".join(f"{name} {_version_of(name)}" for name in _LIBRARIES)


def _version_of(distribution: str) -> str:
    from importlib import metadata  # slow import; --help must stay fast

    try:
        return metadata.version(distribution)
    except metadata.PackageNotFoundError:  # not installed by pip, e.g. vendored
        return _NOT_INSTALLED


@cache
def processor_features() -> str:
    """Return the CPU features that libraries use to select code; they affect the last digits of results."""
    import platform

    import cv2
    import numpy as np
    import scipy.linalg  # noqa: F401  loads scipy's own OpenBLAS, so that threadpoolctl finds it
    from threadpoolctl import threadpool_info

    kernels = {
        f"{one['internal_api']} {one.get('architecture', '')}".strip()
        for one in threadpool_info()
        if one["user_api"] == "blas"
    }
    simd = np.show_config(mode="dicts")["SIMD Extensions"].get("found", [])
    opencv = [name.strip("*") for name in cv2.getCPUFeaturesLine().split() if not name.endswith("?")]
    libc = os.confstr("CS_GNU_LIBC_VERSION") if "CS_GNU_LIBC_VERSION" in os.confstr_names else ""
    by_library = f"numpy {'+'.join(simd) or 'baseline'}", f"OpenCV {'+'.join(opencv)}"
    named = [platform.machine(), libc, *sorted(kernels), *by_library]
    return ", ".join(one for one in named if one)


def build_record() -> dict[str, str]:
    """Return the run record entries that identify the build."""
    return {
        "version": version(),
        "sources": source_digest(),
        "libraries": libraries(),
        "processor": processor_features(),
    }


def only_in(one: str, other: str) -> str:
    """Return the entries of a comma-separated list that another list lacks."""
    return ", ".join(part for part in one.split(", ") if part not in other.split(", "))
