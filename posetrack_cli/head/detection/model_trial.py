"""Validation of YuNet ONNX files in a separate process, because some files crash OpenCV."""

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

TRUSTED_SHA256 = frozenset({"8f2383e4dd3cfbb4553ea8718107fc0423210dc964f9f4280604804ed2552fa4"})
"""Models that are not validated: face_detection_yunet_2023mar.onnx of OpenCV's model zoo."""
STRIDES = (8, 16, 32)
OUTPUTS = {"cls": 1, "obj": 1, "bbox": 4, "kps": 10}
"""Numbers per place of each stride's outputs; OpenCV reads them without checking the shapes."""
SIZES = ((320, 256), (96, 160))
"""Width and height of test images."""
_LONGEST_FAULT = 200


def read_model(path: Path) -> bytes:
    """Read a YuNet model; unknown models are validated first.

    Raises:
        UsageError: the file cannot be read, or OpenCV cannot run it as YuNet.
    """
    try:
        data = read_input(path, limits.MODEL_BYTES)
    except OSError as error:
        found = error.strerror or error
        raise UsageError("cannot read face detector model", where=path, found=found) from error
    if hashlib.sha256(data).hexdigest() not in TRUSTED_SHA256:
        fault = _fault(data)
        if fault:
            raise invalid_model(path, fault)
    return data


def invalid_model(path: Path, found: object) -> UsageError:
    """Return the error for a model that OpenCV cannot run."""
    expected = "an ONNX file of FaceDetectorYN, such as face_detection_yunet_2023mar.onnx"
    return UsageError("not a YuNet model", where=path, found=found, expected=expected)


def _fault(data: bytes) -> str:
    """Run the validation in another process; return the fault, or an empty string."""
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
        return f"validation took more than {limits.MODEL_TRIAL_S} s"
    if done.returncode < 0:
        return f"a network that crashes OpenCV ({signal.Signals(-done.returncode).name})"
    words = " ".join(done.stdout.decode(errors="replace").split())
    return words[:_LONGEST_FAULT] or ("a network that cannot be run" if done.returncode else "")


def _try(data: bytes) -> str:
    """Return why OpenCV cannot run a model as YuNet; empty if it can."""
    names = [f"{kind}_{stride}" for kind in OUTPUTS for stride in STRIDES]
    try:
        network = cv2.dnn.readNetFromONNX(np.frombuffer(data, np.uint8))
        missing = set(names) - set(network.getUnconnectedOutLayersNames())
        if missing:
            return f"a network without output {min(missing)}"
        for width, height in SIZES:
            network.setInput(cv2.dnn.blobFromImage(np.zeros((height, width, 3), np.uint8)))
            for name, values in zip(names, network.forward(names), strict=True):
                kind, stride = name.split("_")
                places = (width // int(stride)) * (height // int(stride))
                if values.dtype != np.float32 or values.shape != (1, places, OUTPUTS[kind]):
                    return f"output {name} has shape {values.shape}, expected {(1, places, OUTPUTS[kind])}"
    except cv2.error as error:
        return str(error.err)
    return ""


def main() -> None:
    """Print the fault of the model on standard input, if any."""
    import resource

    cv2.setNumThreads(1)
    # a malicious model must not exhaust memory or leave a core dump
    _, allowed = resource.getrlimit(resource.RLIMIT_AS)
    most = limits.MODEL_TRIAL_BYTES if allowed < 0 else min(allowed, limits.MODEL_TRIAL_BYTES)
    resource.setrlimit(resource.RLIMIT_AS, (most, allowed))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    print(_try(sys.stdin.buffer.read()))


if __name__ == "__main__":
    main()
