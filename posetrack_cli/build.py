"""What results depend on besides recording, options and seed: posetrack's sources, libraries and processor.

Runs that agree in all of these write equal bytes. The processor changes only last digits: OpenBLAS, numpy and
OpenCV choose their code by its features. Compiled kernels do not depend on it (``compiled``: no fastmath).
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
"""Distributions that decode, compute or encode; another version of them may give other results or bytes."""
_DIGITS = 16
_EVERYTHING = ("**/*",)
_NOT_INSTALLED = "0+unknown"


@cache
def version() -> str:
    """Return the version that posetrack was installed as: last tag, commits since, and the commit."""
    return _version_of("posetrack")


@cache
def source_digest(patterns: tuple[str, ...] = _EVERYTHING, root: Path = PACKAGE) -> str:
    """Return a short digest of the names and contents of the package's files.

    It is computed once in a process: when files change, it stays that of the code which is running.

    Args:
        patterns: which files; by default all, with the shipped configurations.
        root: the package's folder.
    """
    files = {path.relative_to(root).as_posix(): path for one in patterns for path in root.glob(one)}
    if patterns == _EVERYTHING and not (root / "configs").is_dir():
        configs = root.parent / "configs"  # of a checkout
        files |= {path.relative_to(root.parent).as_posix(): path for path in configs.rglob("*.toml")}
    digest = hashlib.sha256()
    for name, path in sorted(files.items()):
        if "__pycache__" not in path.parts and path.is_file():
            content = path.read_bytes()
            digest.update(f"{name}\0{len(content)}\0".encode() + content)
    return digest.hexdigest()[:_DIGITS]


def build_name() -> str:
    """Return version and digest of the sources in words."""
    return f"{version()} (sources {source_digest()})"


@cache
def libraries() -> str:
    """Return names and versions of the libraries that results depend on."""
    return ", ".join(f"{name} {_version_of(name)}" for name in _LIBRARIES)


def _version_of(distribution: str) -> str:
    from importlib import metadata  # takes longer than --help may

    try:
        return metadata.version(distribution)
    except metadata.PackageNotFoundError:  # put there by other means than pip
        return _NOT_INSTALLED


@cache
def processor_features() -> str:
    """Return what the last digits of results depend on: features that libraries choose their code by."""
    import platform

    import cv2
    import numpy as np
    import scipy.linalg  # noqa: F401  loads an OpenBLAS of its own
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
    """Return the entries of a run record that state what the run was made with."""
    return {
        "version": version(),
        "sources": source_digest(),
        "libraries": libraries(),
        "processor": processor_features(),
    }


def only_in(one: str, other: str) -> str:
    """Return the parts of a list of libraries or features that another list does not have."""
    return ", ".join(part for part in one.split(", ") if part not in other.split(", "))
