"""Recordings in the layouts of other tools and of public data, written by their descriptions."""

from __future__ import annotations

import base64
import io
import json
import struct
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

R3D_SIZE, R3D_COLOUR = (64, 48), (256, 192)
"""Width and height of depth and colour in Record3D's recordings here; the app's are 192x256 and 720x960."""
R3D_NOISY_BORDER = 4
"""Columns and rows of confidence 0."""
STRAY_VIDEO = (320, 240)
STRAY_MATRIX = (266.0, 266.0, 159.5, 119.5)
BIWI_COLOUR, BIWI_DEPTH = (517.679, 517.679, 320.0, 240.5), (575.816, 575.816, 320.0, 240.0)

# Made once by Apple's encoder of ``r3d_depth`` and ``r3d_levels``: the bytes of an app, not of ours
LZFSE_DEPTH = base64.b85decode(
    "Vs>~k05AXmZ~>4K03iTy{qB25YES?Wy#N3JKFA;n=WuogBM@K!2><{<fV>2U56A%k0000090CBq0UU66cz6f^0001RGjHac2"
    "lHkgFqupy6KD?(4h{|u4h{~^4h{|u4rUML&Agd6^JX5*n|Vp;?T<oB+m^Nk+Lm%aDWyP}l+sdKfVPwt%A~+#QYMp9O53(=Ti"
    "Q~XOeT}bWKzncZChGeC@r03Qf`<)nUu+dmKI9OoO8||00000;2Co48VU5PiOG(*hZbbY_sk75DkVf&HOeH%ajfes52*hUFTO"
    "l9ZiqcJvU71Ic<*-y6;sy;fhU?R2#h_Oj%tF3>XYe_6wuOnq%GAo8rZO^VWtzEJbUVu>CYFyr<uKxtoLF3y?2C5-D^3un>Ts"
    "o0?qrSLe!ay%1lg9%M{dKq$MeCNfhdLoApO{m7C(rmG{b(iJbe&CiI{))ZasO@Ws`&gXwA?)nz+K3@<l^PfP;pD1iyA{>bI&"
    ")8CeUSL5K(%>=JSGc@u9p;NmB=JgfWvs2jCfP}rw1|<y=<T%NI?3A%j_H=${OGk%rvbtcBm2sIW?SNEP*AiXDC6Pc=8mOefz"
    "LNADl8A;Bt05`ss}pcsOYj?*zJaB@N0a~n00000000000*Q(QCpJicLQCK?L%=g5(3vN|nG@K|641;EGG>&(BkQZ;Xp*JN;x"
    "H_drxC~EO7XlhERY0C<m;r$0=l(p7@_~47y)8-cq9"
)
LZFSE_LEVELS = base64.b85decode(
    "Vs>~k02lxO3;-|y00sacRj5`~RT2PDiU0rrBixV(f4~jg+yDRozzqNZ0Kg3|!K3j#0002MPXGV_000000000006aS1(@zEf0"
    "000000000000000000000000000000000000000000000000000000000000000000000000000002g0{{R3000000HCG*f8"
    "_u5y-OHkc6cN"
)


def r3d_depth() -> np.ndarray:
    """Depth, m: a slope with a hill that is nearer."""
    y, x = np.mgrid[: R3D_SIZE[1], : R3D_SIZE[0]]
    hill = (x - 32) ** 2 + (y - 24) ** 2 < 200
    return (np.round(600 + 2 * x + np.where(hill, -150, 0)) / 1000).astype("<f4")


def r3d_levels() -> np.ndarray:
    """Confidence: 2, but less at two edges; twice as wide as depth, as small images are coded otherwise."""
    y, x = np.mgrid[: R3D_SIZE[1], : R3D_SIZE[0]]
    noisy = (x < R3D_NOISY_BORDER) | (y < R3D_NOISY_BORDER - 1)
    return np.tile(np.where(noisy, 0, np.where(x < 2 * R3D_NOISY_BORDER, 1, 2)), (1, 2)).astype(np.uint8)


def lzfse_as_stored(data: bytes) -> bytes:
    """A stream of one block that is not compressed."""
    return b"bvx-" + struct.pack("<I", len(data)) + data + b"bvx$"


def r3d_metadata(count: int, **changes: Any) -> dict[str, Any]:
    metadata = {
        "w": R3D_COLOUR[0],
        "h": R3D_COLOUR[1],
        "dw": R3D_SIZE[0],
        "dh": R3D_SIZE[1],
        "K": [240.0, 0.0, 0.0, 0.0, 241.0, 0.0, 127.5, 95.5, 1.0],
        "fps": 60,
        "frameTimestamps": [100.0 + number / 60 for number in range(count)],
        "poses": [[0.0] * 7] * count,
    }
    return {key: value for key, value in (metadata | changes).items() if value is not None}


def r3d_files(count: int = 3, **changes: Any) -> dict[str, bytes]:
    """Names and contents of a recording of Record3D."""
    files = {"metadata": json.dumps(r3d_metadata(count, **changes)).encode()}
    levels = lzfse_as_stored(r3d_levels()[:, : R3D_SIZE[0]].tobytes())
    for number in range(count):
        files[f"rgbd/{number}.depth"] = LZFSE_DEPTH
        files[f"rgbd/{number}.conf"] = levels
        files[f"rgbd/{number}.jpg"] = colour_image(number, R3D_COLOUR, ".jpg")
    return files


def r3d_bytes(files: dict[str, bytes], compression: int = zipfile.ZIP_STORED) -> bytes:
    """The archive of a recording of Record3D."""
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", compression) as archive:
        for name, data in files.items():
            archive.writestr(zipfile.ZipInfo(name), data, compression)
    return content.getvalue()


def write_r3d(path: Path, files: dict[str, bytes], compression: int = zipfile.ZIP_STORED) -> Path:
    path.write_bytes(r3d_bytes(files, compression))
    return path


def write_files(folder: Path, files: dict[str, bytes]) -> Path:
    for name, data in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(data)
    return folder


def colour_image(number: int, size: tuple[int, int], suffix: str) -> bytes:
    """A picture of a number: a bar at its place."""
    image = np.full((size[1], size[0], 3), (40, 90, 160), np.uint8)
    image[:, 8 * number : 8 * number + 8] = (200, 30, 60)
    return cv2.imencode(suffix, image)[1].tobytes()


def depth_codes(number: int, size: tuple[int, int]) -> np.ndarray:
    """Depth, mm, with a hole that moves."""
    y, x = np.mgrid[: size[1], : size[0]]
    codes = (700 + x // 2 + y // 3).astype(np.uint16)
    codes[10:20, 5 * number : 5 * number + 9] = 0
    return codes


def stray_files(
    count: int = 3, *, numbers: Sequence[int] | None = None, focal: Sequence[float] | None = None
) -> dict[str, bytes]:
    """Names and contents of a folder of Stray Scanner, but for its video.

    Args:
        count: of images.
        numbers: of those with a line in the odometry; all if None.
        focal: lengths of each image, px of the video, as newer versions write them.
    """
    files = {}
    for number in range(count):
        levels = np.full((192, 256), 2, np.uint8)
        levels[:, :7], levels[:, 7:9] = 0, 1
        files[f"depth/{number:06}.png"] = png(depth_codes(number, (256, 192)))
        files[f"confidence/{number:06}.png"] = png(levels)
    fx, fy, cx, cy = STRAY_MATRIX
    files["camera_matrix.csv"] = f"{fx}, 0.0, {cx}\n0.0, {fy}, {cy}\n0.0, 0.0, 1.0".encode()
    head = "timestamp, frame, x, y, z, qx, qy, qz, qw" + ("" if focal is None else ", fx, fy, cx, cy")
    lines = [head]
    for number in range(count) if numbers is None else numbers:
        more = "" if focal is None else f", {focal[number]}, {focal[number]}, {cx}, {cy}"
        lines.append(f"{5000 + number / 60:.6f}, {number:06}, 0.1, 0.2, 0.3, 0.0, 0.0, 0.0, 1.0{more}")
    files["odometry.csv"] = "\n".join(lines).encode()
    files["imu.csv"] = b"timestamp, a_x, a_y, a_z, alpha_x, alpha_y, alpha_z"
    return files


def biwi_runs(codes: np.ndarray) -> bytes:
    """Depth as the data store it: size, then pairs of runs, the readings behind the second."""
    parts, values = [struct.pack("<ii", codes.shape[1], codes.shape[0])], codes.ravel().astype("<i2")
    edges = np.flatnonzero(np.diff(np.concatenate([[0], (values != 0).astype(int), [0]])))
    reached = 0
    for begin, end in edges.reshape(-1, 2):
        parts.append(struct.pack("<ii", begin - reached, end - begin) + values[begin:end].tobytes())
        reached = end
    if reached < len(values):
        parts.append(struct.pack("<ii", len(values) - reached, 0))
    return b"".join(parts)


def biwi_calibration(intrinsics: tuple[float, float, float, float], distortion: str = "0 0 0 0") -> bytes:
    fx, fy, cx, cy = intrinsics
    blocks = (
        f"{fx} 0 {cx} \n0 {fy} {cy} \n0 0 1 ",
        distortion,
        "0.999947 0.0043 0.0093 \n-0.0045 0.99988 0.015 \n-0.0092 -0.0151 0.99984 ",
        "-24.0198 5.8896 -13.2308 ",
        "640 480 ",
    )
    return "\n\n".join(blocks).encode()


def biwi_files(numbers: Sequence[int] = (3, 4, 6)) -> dict[str, bytes]:
    """Names and contents of a sequence of the Biwi Kinect head pose data."""
    files = {"rgb.cal": biwi_calibration(BIWI_COLOUR), "depth.cal": biwi_calibration(BIWI_DEPTH)}
    for number in numbers:
        files[f"frame_{number:05}_rgb.png"] = colour_image(number, (640, 480), ".png")
        files[f"frame_{number:05}_depth.bin"] = biwi_runs(depth_codes(number, (640, 480)))
        files[f"frame_{number:05}_pose.txt"] = b"1 0 0 \n0 1 0 \n0 0 1 \n\n10 20 900 \n"
    return files


def nyu_image(codes: np.ndarray) -> bytes:
    """Depth packed as the data have it: upper bits green, lower bits blue, anything in red."""
    red = np.random.default_rng(0).integers(0, 256, codes.shape)
    return png(np.dstack([codes & 255, codes >> 8, red]).astype(np.uint8))


def nyu_files(cameras: Sequence[int] = (1, 2), count: int = 3) -> dict[str, bytes]:
    """Names and contents of a folder of NYU's hand pose data; each camera's depth is 100 mm farther."""
    return {
        f"{kind}_{camera}_{number:07}.png": nyu_image(
            depth_codes(number, (640, 480)) + np.uint16(100 * camera)
        )
        for kind in ("depth", "synthdepth")
        for camera in cameras
        for number in range(1, count + 1)
    }


def png(image: np.ndarray) -> bytes:
    return cv2.imencode(".png", image)[1].tobytes()
