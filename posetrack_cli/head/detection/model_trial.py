"""Try whether an ONNX file is a model of YuNet, in a process of its own: some files crash OpenCV."""

from __future__ import annotations

import hashlib
import signal
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np

from posetrack_cli import limits
from posetrack_cli.errors import UsageError
from posetrack_cli.files import read_input
from posetrack_cli.interpreter import module_command, module_environment

KNOWN = frozenset({"8f2383e4dd3cfbb4553ea8718107fc0423210dc964f9f4280604804ed2552fa4"})
"""SHA-256 of models that are not tried: face_detection_yunet_2023mar.onnx of OpenCV's model zoo."""
STRIDES = (8, 16, 32)
OUTPUTS = {"cls": 1, "obj": 1, "bbox": 4, "kps": 10}
"""Of each stride, with the numbers of a place; OpenCV reads as many without a look at what there are."""
SIZES = ((320, 256), (96, 160))
"""Width and height of images that a model is tried with."""
_LONGEST_FAULT = 200


def read_model(path: Path) -> bytes:
    """Return a model of YuNet as its file has it; another than the known one is tried first.

    Raises:
        UsageError: it cannot be read, or OpenCV cannot run it as YuNet.
    """
    try:
        data = read_input(path, limits.MODEL_BYTES)
    except OSError as error:
        found = error.strerror or error
        raise UsageError("face detector's model cannot be read", where=path, found=found) from error
    if hashlib.sha256(data).hexdigest() not in KNOWN:
        fault = _fault(data)
        if fault:
            raise not_yunet(path, fault)
    return data


def not_yunet(path: Path, found: object) -> UsageError:
    """Return the error for a model that OpenCV cannot run."""
    expected = "an ONNX file of FaceDetectorYN, such as face_detection_yunet_2023mar.onnx"
    return UsageError("not a model of YuNet", where=path, found=found, expected=expected)


def _fault(data: bytes) -> str:
    """Return why a model cannot be used, found by another process; empty if it can."""
    try:
        done = subprocess.run(
            module_command(__name__),
            input=data,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=module_environment(),
            timeout=limits.MODEL_TRIAL_S,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return f"a network that takes more than {limits.MODEL_TRIAL_S} s to try"
    if done.returncode < 0:
        return f"a network that ends OpenCV by {signal.Signals(-done.returncode).name}"
    words = " ".join(done.stdout.decode(errors="replace").split())
    return words[:_LONGEST_FAULT] or ("a network that cannot be tried" if done.returncode else "")


def _try(data: bytes) -> str:
    """Return why OpenCV cannot run a model as YuNet; empty if it can."""
    names = [f"{kind}_{stride}" for kind in OUTPUTS for stride in STRIDES]
    try:
        network = cv2.dnn.readNetFromONNX(np.frombuffer(data, np.uint8))
        missing = set(names) - set(network.getUnconnectedOutLayersNames())
        if missing:
            return f"a network without the output {min(missing)}"
        for width, height in SIZES:
            network.setInput(cv2.dnn.blobFromImage(np.zeros((height, width, 3), np.uint8)))
            for name, values in zip(names, network.forward(names), strict=True):
                kind, stride = name.split("_")
                places = (width // int(stride)) * (height // int(stride))
                if values.dtype != np.float32 or values.shape != (1, places, OUTPUTS[kind]):
                    return f"output {name} of shape {values.shape}, not {(1, places, OUTPUTS[kind])}"
    except cv2.error as error:
        return str(error.err)
    return ""


def main() -> None:
    """Print what is wrong with the model on standard input, if anything is."""
    import resource

    cv2.setNumThreads(1)
    _, allowed = resource.getrlimit(resource.RLIMIT_AS)
    most = limits.MODEL_TRIAL_BYTES if allowed < 0 else min(allowed, limits.MODEL_TRIAL_BYTES)
    resource.setrlimit(resource.RLIMIT_AS, (most, allowed))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    print(_try(sys.stdin.buffer.read()))


if __name__ == "__main__":
    main()
