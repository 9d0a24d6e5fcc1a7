"""Files as k4arecorder writes them: Matroska with depth and infrared as b16g, colour, and a calibration."""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import av
import numpy as np

COUNT = 5
FOURCC = b"V_MS/VFW/FOURCC"
BITMAP_HEAD = struct.Struct("<IiiHH4sI")
DEPTH_PARAMETERS = (
    *(0.5122697949409485, 0.49451231956481934, 0.4921168386936188, 0.4921667277812958),
    *(3.1305770874023438, 2.324939012527466, 0.1304156482219696),
    *(3.458651542663574, 3.350114583969116, 0.6629416346549988),
    *(0.0, 0.0, -0.0000511557373101823, 0.00008132171933539212),
)
"""Of somebody's sensor (github panispani/3DReconstruct, calib.md), and what the SDK makes of them:"""
DEPTH_640X576 = {"cx": 332.064270, "cy": 325.880615, "fx": 503.927643, "fy": 503.978729}


def calibration(parameters: tuple[float, ...] = DEPTH_PARAMETERS, **changes: Any) -> dict[str, Any]:
    """The attachment, as far as it is read; ``changes`` are of the depth camera."""
    model = "CALIBRATION_LensDistortionModelBrownConrady"
    intrinsics = {"ModelParameterCount": 14, "ModelParameters": list(parameters), "ModelType": model}
    sensor = {"SensorWidth": 1024, "SensorHeight": 1024, "MetricRadius": 1.74}
    depth = {"Location": "CALIBRATION_CameraLocationD0", "Intrinsics": intrinsics, **sensor, **changes}
    colour = {**depth, "Location": "CALIBRATION_CameraLocationPV0", "SensorWidth": 4096, "SensorHeight": 3072}
    return {"CalibrationInformation": {"Cameras": [colour, depth]}}


def codes(number: int, size: tuple[int, int]) -> np.ndarray:
    """Depth, mm: a tilted plane."""
    v, u = np.mgrid[0 : size[1], 0 : size[0]]
    return (500 + u + 3 * v + 10 * number).astype(np.uint16)


def write_kinect(
    path: Path,
    size: tuple[int, int] = (320, 288),
    attached: Mapping[str, Any] | None = None,
    titles: tuple[str, ...] = ("COLOR", "DEPTH", "IR"),
) -> Path:
    """FFmpeg's muxer writes no b16g, but the same bytes: what kind they are is put into the head."""
    with av.open(str(path), "w", format="matroska", options={"allow_raw_vfw": "1"}) as container:
        streams = []
        for title in titles:
            stream = container.add_stream("mjpeg" if title == "COLOR" else "rawvideo", rate=30)
            stream.width, stream.height = (128, 96) if title == "COLOR" else size
            stream.pix_fmt = "yuvj420p" if title == "COLOR" else "gray16be"
            stream.metadata["title"] = title
            streams.append(stream)
        values = calibration() if attached is None else attached
        data = json.dumps(values).encode()
        container.add_attachment("calibration.json", "application/octet-stream", data)
        for number in range(COUNT):
            for title, stream in zip(titles, streams, strict=True):
                container.mux(stream.encode(_frame(title, number, size)))
        for stream in streams:
            container.mux(stream.encode(None))
    data = bytearray(path.read_bytes())
    at = 0
    while (at := data.find(FOURCC, at + 1)) >= 0:
        head = data.index(struct.pack("<I", BITMAP_HEAD.size + 16), at)
        values = list(BITMAP_HEAD.unpack_from(data, head))
        BITMAP_HEAD.pack_into(data, head, *values[:4], 16, b"b16g", values[6])
    path.write_bytes(data)
    return path


def _frame(title: str, number: int, size: tuple[int, int]) -> av.VideoFrame:
    if title == "COLOR":
        image = np.full((96, 128, 3), 40 * number, np.uint8)
        frame = av.VideoFrame.from_ndarray(image, format="bgr24").reformat(format="yuvj420p")
    else:
        values = codes(number, size) if title == "DEPTH" else np.full(size[::-1], 7, np.uint16)
        frame = av.VideoFrame.from_ndarray(values, format="gray16le").reformat(format="gray16be")
    frame.pts = number
    return frame
