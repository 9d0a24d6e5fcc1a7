"""Models of the face detector: unknown ones are tried apart, and none leads to faces that cannot be."""

from __future__ import annotations

import hashlib
import sys
from pathlib import Path

import numpy as np
import pytest

from posetrack_cli import limits
from posetrack_cli.errors import UsageError
from posetrack_cli.head.detection import model_trial
from posetrack_cli.head.detection.finders import YunetFaces
from posetrack_cli.head.detection.model_trial import read_model
from support.onnx_file import CHANNELS, yunet_like

SURE = {"cls": [1.0], "obj": [1.0], "bbox": [0.0] * 4}
FACE = [-1.0, 0.0, 1.0, 0.0, 0.0, 0.5, -0.8, 2.0, 0.8, 2.0]
"""Eyes, nose and corners of the mouth from a place, in strides."""
IMAGE = np.zeros((96, 128), np.uint8)


def model(folder: Path, data: bytes) -> Path:
    path = folder / "m.onnx"
    path.write_bytes(data)
    return path


def test_a_network_of_yunet_s_outputs_is_used(tmp_path: Path) -> None:
    """Its faces are where the outputs say: eyes two strides apart, one row of places below the other."""
    faces = YunetFaces(model(tmp_path, yunet_like(SURE | {"kps": FACE}))).find(IMAGE)
    assert faces
    for face in faces:
        (right,), (left,) = face.eyes
        stride = (left[0] - right[0]) / 2.0
        assert stride in (8.0, 16.0, 32.0) and left[1] == right[1] and face.roll == 0.0
        np.testing.assert_allclose(right / stride % 1.0, 0.0, atol=1e-6)
        assert face.eye_distance == pytest.approx(max(2.0 * stride, 2.0 * stride / 1.09))


@pytest.mark.parametrize("kps", [[0.0] * 10, [np.nan] * 10, [np.inf] * 10, [1e30] * 10, [-9.0, *FACE[1:]]])
def test_faces_that_cannot_be_are_left_out(tmp_path: Path, kps: list[float]) -> None:
    """Eyes in one place divided by zero, and a face larger than the image was cut out of it."""
    faces = YunetFaces(model(tmp_path, yunet_like(SURE | {"kps": kps}))).find(IMAGE)
    assert all(1.0 <= face.eye_distance <= 2560.0 for face in faces)
    assert kps[0] == -9.0 or faces == ()


REFUSED = {
    "no network": (b"noise", "Failed to parse"),
    "an output of another shape": (
        yunet_like(SURE | {"kps": FACE}, {**CHANNELS, "kps": 2}),
        r"output kps_8 has shape \(1, 1280, 2\), expected \(1, 1280, 10\)",
    ),
    "an output that is missing": (
        yunet_like(SURE | {"kps": FACE}, left_out=["bbox_16"]),
        "a network without output bbox_16",
    ),
    "an operation that OpenCV has not": (yunet_like(SURE | {"kps": FACE}, operation="Other"), "Other"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_other_files_are_refused_in_one_line(tmp_path: Path, name: str) -> None:
    data, words = REFUSED[name]
    with pytest.raises(UsageError, match=rf"m\.onnx: not a YuNet model, found .*{words}.*, expected an ONNX"):
        YunetFaces(model(tmp_path, data))


@pytest.mark.parametrize(
    ("program", "words"),
    [
        (
            "import os, signal; os.kill(os.getpid(), signal.SIGSEGV)",
            r"a network that crashes OpenCV \(SIGSEGV\)",
        ),
        ("import os; os.abort()", r"a network that crashes OpenCV \(SIGABRT\)"),
        ("import time; time.sleep(60)", "validation took more than 1 s"),
        ("raise MemoryError", "a network that cannot be run"),
    ],
)
def test_a_file_that_ends_the_process_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, program: str, words: str
) -> None:
    """As OpenCV 4.14 does, by SIGSEGV, for some in which a few bytes are damaged."""
    monkeypatch.setattr(model_trial, "module_command", lambda module: [sys.executable, "-c", program])
    monkeypatch.setattr(limits, "MODEL_TRIAL_S", 1 if "sleep" in program else 60)
    with pytest.raises(UsageError, match=f"not a YuNet model, found {words}"):
        read_model(model(tmp_path, b"x"))


def test_the_known_model_is_not_tried(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(model_trial, "module_command", lambda module: ["false"])
    path = model(tmp_path, b"x")
    with pytest.raises(UsageError):
        read_model(path)
    monkeypatch.setattr(model_trial, "TRUSTED_SHA256", {hashlib.sha256(b"x").hexdigest()})
    assert read_model(path) == b"x"


def test_the_digest_is_of_the_model_that_the_documentation_names(measured_data: Path) -> None:
    data = (measured_data / "faces" / "face_detection_yunet_2023mar.onnx").read_bytes()
    assert hashlib.sha256(data).hexdigest() in model_trial.TRUSTED_SHA256
