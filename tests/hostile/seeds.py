"""Small valid inputs of every kind, most of them written by posetrack itself."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from hostile.case import Case, Content
from hostile.mcap_bytes import CHANNEL, CHUNK, MESSAGE, SCHEMA, Record, file_bytes, read_records
from hostile.running import SEED, Harness, Pool
from support import datasets as layouts
from support import recordings
from support.rvl import encoded as encoded_rvl

FRAMES = 3
STEP = 8
"""Every so many pixels of a synthetic hand's images are kept: 64 x 53."""
START_NS = 1_700_000_000_000_000_000
PERIOD_NS = 33_333_333
LISTED = [f"1305031102.{160407 + 33333 * k}" for k in range(FRAMES)]
"""Names of images in TUM's layout."""
QUICK_HAND = (
    "--particles",
    "8",
    "--hand-side",
    "right",
    "--shape",
    "average",
    "--set",
    "output.flush_frames=1",
)
QUICK_HEAD = ("--particles", "20", "--set", "output.flush_frames=1")
FACE_MODEL = Path(__file__).parents[2] / "posetrack_cli/head/multilinear/default.npz"


@dataclass(frozen=True)
class Seeds:
    """Valid inputs; a recording is files by name, what is one file is bytes.

    Attributes:
        depth: images (3, 53, 64) uint16, mm.
        grey: images (3, 120, 160) uint8 with a face.
        hand: an MCAP recording of depth with truth.
        heads: an MCAP recording of two cameras.
        results: of ``hand``, ``stereo`` and ``mono``.
        interrupted: of each the ``.part`` and the ``.part.state``.
        models: what ``stereo`` and ``mono`` learned.
        commands: of each the command line, without output.
    """

    depth: np.ndarray[Any, Any]
    grey: np.ndarray[Any, Any]
    hand: bytes
    heads: bytes
    results: Mapping[str, bytes]
    interrupted: Mapping[str, tuple[bytes, bytes]]
    models: Mapping[str, bytes]
    commands: Mapping[str, tuple[str, ...]]

    @property
    def face_model(self) -> bytes:
        return FACE_MODEL.read_bytes()


CAMERA_TOML = "fx = 45.625\nfy = 45.625\ncx = 31.5\ncy = 26.0\n"
COMMANDS = {
    "hand": ("hand", "run", "hand.mcap", *QUICK_HAND, "--init", "center"),
    "stereo": ("head", "stereo", "heads.mcap", *QUICK_HEAD),
    "mono": ("head", "mono", "heads.mcap", *QUICK_HEAD, "--cameras", "left", "--passes", "1"),
}


def make_seeds(pool: Pool) -> Seeds:
    """Make all seeds, and warm the harnesses up; takes some seconds."""
    hand, heads = pool.map(_recording, ("hand", "heads"))
    pool.map(lambda harness, _: _warm_up(harness, heads), pool.harnesses)
    files: dict[str, Content] = {"hand.mcap": _reduced(hand)[0], "heads.mcap": heads}
    made = dict(zip(COMMANDS, pool.map(lambda h, kind: _tracked(h, kind, files), COMMANDS), strict=True))
    return Seeds(
        depth=_reduced(hand)[1],
        grey=_grey(heads),
        hand=bytes(files["hand.mcap"]),
        heads=heads,
        results={kind: result for kind, (result, _, _) in made.items()},
        interrupted={kind: stopped for kind, (_, stopped, _) in made.items()},
        models={kind: model for kind, (_, _, model) in made.items() if model},
        commands=COMMANDS,
    )


def _recording(harness: Harness, kind: str) -> bytes:
    command: tuple[str, ...] = ("hand", "synth", "--frames", str(FRAMES), "--seed", "3", "--no-drops")
    if kind == "heads":
        size = ("--image-size", "160x120", "--image-format", "png", "--motion", "slight")
        command = ("head", "synth", "--frames", str(FRAMES), "--seed", "3", *size)
    return _made_files(harness, (*command, "-o", "out.mcap"), {})["out.mcap"]


def _tracked(
    harness: Harness, kind: str, files: Mapping[str, Content]
) -> tuple[bytes, tuple[bytes, bytes], bytes]:
    """Return a result, part and state of an interrupted run, and what was learned."""
    command = COMMANDS[kind]
    recording = {name: files[name] for name in files if name in command}
    made = _made_files(harness, (*command, "-o", "out.mcap", *_model_options(kind)), recording)
    stopped = _made_files(harness, (*command, "-o", "out.mcap"), recording, stop_after=2)
    parts = stopped["out.mcap.part"], stopped["out.mcap.part.state"]
    return made["out.mcap"], parts, made.get("model.npz", b"")


def _warm_up(harness: Harness, heads: bytes) -> None:
    """Load the compiled code of heads and of images once, for all children; what needs GL is theirs."""
    folder = harness.scratch / "warm"
    folder.mkdir(exist_ok=True)
    (folder / "heads.mcap").write_bytes(heads)
    swap = {"heads.mcap": str(folder / "heads.mcap")}
    tail = ("--end", "2", "--overwrite")
    commands = [
        [*(swap.get(word, word) for word in COMMANDS[kind]), "-o", str(folder / f"{kind}.mcap"), *tail]
        for kind in ("stereo", "mono")
    ]
    layouts.write_r3d(folder / "lzfse.r3d", layouts.r3d_files(1))
    _write_rvl(folder / "rvl.mcap")
    for name in ("lzfse.r3d", "rvl.mcap"):
        commands.append(["convert", str(folder / name), "-o", str(folder / "out.mcap"), "--overwrite"])
    harness.warm(commands)


def _write_rvl(path: Path) -> None:
    """Write one message of depth in RVL, and its calibration."""
    image = recordings.depth_codes(1)[0]
    content = {"format": "16UC1; compressedDepth rvl", "data": bytes(12) + encoded_rvl(image)}
    calibration = recordings.calibration_fields(upper=False)
    messages = [
        ("/cam/camera_info", "CameraInfo", START_NS, START_NS, calibration),
        ("/cam/image/compressedDepth", "CompressedImage", START_NS, START_NS, content),
    ]
    recordings.write_ros2(path, messages)


def _model_options(kind: str) -> tuple[str, ...]:
    return () if kind == "hand" else ("--save-model", "model.npz")


def _made_files(
    harness: Harness, command: tuple[str, ...], files: Mapping[str, Content], stop_after: int | None = None
) -> dict[str, bytes]:
    case = Case(SEED, command, files, ("out.mcap", "model.npz"))
    made, outcome = harness.run_and_read(case, stop_after=stop_after)
    if outcome.code not in ((0,) if stop_after is None else (130,)):
        raise RuntimeError(
            f"no seed from {case.command_line()}: {outcome.code} {outcome.error.decode()}{outcome.stacks}"
        )
    return made


def _reduced(large: bytes) -> tuple[bytes, np.ndarray[Any, Any]]:
    """Return a recording of a hand with every eighth pixel only, and its images."""
    from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
    from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
    from foxglove_schemas_protobuf.RawImage_pb2 import RawImage

    records, images = read_records(large), []
    names = message_types(records)
    for message in messages(records):
        kind = names[message["channel_id"]]
        if kind == "foxglove.CompressedImage":
            compressed = CompressedImage.FromString(message["data"])
            code = np.frombuffer(compressed.data, np.uint8)
            small = np.ascontiguousarray(cv2.imdecode(code, cv2.IMREAD_UNCHANGED)[::STEP, ::STEP])
            compressed.data = cv2.imencode(".png", small)[1].tobytes()
            message["data"] = compressed.SerializeToString(deterministic=True)
            images.append(small)
        elif kind == "foxglove.RawImage":
            raw = RawImage.FromString(message["data"])
            whole = np.frombuffer(raw.data, np.uint16).reshape(raw.height, raw.width)
            small = np.ascontiguousarray(whole[::STEP, ::STEP])
            raw.height, raw.width = small.shape
            raw.step, raw.data = 2 * small.shape[1], small.tobytes()
            message["data"] = raw.SerializeToString(deterministic=True)
            images.append(small)
        elif kind == "foxglove.CameraCalibration":
            camera = CameraCalibration.FromString(message["data"])
            camera.width, camera.height = -(-camera.width // STEP), -(-camera.height // STEP)
            for k in (0, 2, 4, 5):
                camera.K[k] /= STEP
            for k in (0, 2, 5, 6):
                camera.P[k] /= STEP
            message["data"] = camera.SerializeToString(deterministic=True)
    return file_bytes(records), np.stack(images)


def _grey(heads: bytes) -> np.ndarray[Any, Any]:
    from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage

    records = read_records(heads)
    names, images = message_types(records), []
    first = None
    for message in messages(records):
        if names[message["channel_id"]] == "foxglove.CompressedImage":
            first = message["channel_id"] if first is None else first
            if message["channel_id"] == first:
                data = CompressedImage.FromString(message["data"]).data
                images.append(cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE))
    return np.stack(images)


def every(records: list[Record]) -> list[Record]:
    """Return all records, those in chunks, too."""
    return [r for record in records for r in (record, *record.get("inner", ()))]


def messages(records: list[Record]) -> list[Record]:
    return [record for record in every(records) if record["op"] == MESSAGE]


def message_types(records: list[Record]) -> dict[int, str]:
    """Return the schema's name of each channel."""
    schemas = {r["id"]: r["name"] for r in every(records) if r["op"] == SCHEMA}
    return {r["id"]: schemas.get(r["schema_id"], "") for r in every(records) if r["op"] == CHANNEL}


# Files of other kinds


def depth_folder(seeds: Seeds) -> dict[str, Content]:
    files: dict[str, Content] = {f"rec/{k:06d}.png": png(image) for k, image in enumerate(seeds.depth)}
    files["rec/camera.toml"] = CAMERA_TOML.encode()
    files["rec/timestamps.csv"] = stamps_csv().encode()
    return files


def grey_folder(seeds: Seeds, cameras: tuple[str, ...] = ("left", "right")) -> dict[str, Content]:
    files: dict[str, Content] = {}
    for camera in cameras:
        files |= {f"rec/{camera}/{k:06d}.png": png(image) for k, image in enumerate(seeds.grey)}
    files["rec/camera.toml"] = rig_toml(cameras).encode()
    files["rec/timestamps.csv"] = stamps_csv().encode()
    return files


def png(image: np.ndarray[Any, Any]) -> bytes:
    return encoded(".png", image)


def encoded(suffix: str, image: np.ndarray[Any, Any]) -> bytes:
    data: bytes = cv2.imencode(suffix, image)[1].tobytes()
    return data


@cache
def _stack(images: bytes, shape: tuple[int, ...], dtype: str) -> bytes:
    return cv2.imencodemulti(".tiff", list(np.frombuffer(images, dtype).reshape(shape)))[1].tobytes()


def stack(images: np.ndarray[Any, Any]) -> bytes:
    """Return a TIFF whose pages are images (N, height, width)."""
    return _stack(images.tobytes(), images.shape, images.dtype.str)


def listed_folder(seeds: Seeds) -> dict[str, Content]:
    """A folder of TUM with depth and colour, their lists in it."""
    files: dict[str, Content] = {"rec/camera.toml": CAMERA_TOML.encode()}
    files |= {f"rec/depth/{name}.png": png(image) for name, image in zip(LISTED, seeds.depth, strict=True)}
    files |= {f"rec/rgb/{name}.png": png(image) for name, image in zip(LISTED, seeds.grey, strict=True)}
    return files | {f"rec/{kind}.txt": image_list(kind).encode() for kind in ("depth", "rgb")}


def image_list(kind: str) -> str:
    return "\n".join(["# timestamp filename", *(f"{name} {kind}/{name}.png" for name in LISTED)]) + "\n"


def camera_folders(seeds: Seeds) -> dict[str, Content]:
    """Folders of EuRoC: of each camera data.csv and data/."""
    files: dict[str, Content] = {"rec/camera.toml": rig_toml(("cam0", "cam1")).encode()}
    for camera in ("cam0", "cam1"):
        files |= {
            f"rec/{camera}/data/{START_NS + k * PERIOD_NS}.png": png(image)
            for k, image in enumerate(seeds.grey)
        }
        files[f"rec/{camera}/data.csv"] = camera_list().encode()
    return files


def camera_list() -> str:
    rows = [f"{START_NS + k * PERIOD_NS},{START_NS + k * PERIOD_NS}.png" for k in range(FRAMES)]
    return "\n".join(["#timestamp [ns],filename", *rows]) + "\n"


def stamps_csv() -> str:
    rows = [f"{k:06d}.png,{START_NS + k * PERIOD_NS}" for k in range(FRAMES)]
    return "\n".join(["filename,stamp_ns", *rows]) + "\n"


def rig_toml(cameras: tuple[str, ...] = ("left", "right")) -> str:
    lines = [f'reference = "{cameras[0]}"']
    for k, name in enumerate(cameras):
        lines += [f"[cameras.{name}]", "fx = 250.0", "fy = 250.0", "cx = 79.5", "cy = 59.5"]
        if k:
            lines += [
                "rotation = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]",
                "translation_mm = [-120.0, 0.0, 0.0]",
            ]
    return "\n".join(lines) + "\n"


def clicked_csv(cameras: tuple[str, ...] = ("left",)) -> str:
    from posetrack_cli.head.face.points import POINT_NAMES

    rows = [f"{c},{name},{60 + 4 * k},{50 + 3 * k}" for c in cameras for k, name in enumerate(POINT_NAMES)]
    return "\n".join(["camera,point,x,y", *rows]) + "\n"


def keypoints_csv() -> str:
    """Keypoints for the first frames of the hand's recording, by number."""
    header = ",".join(["frame", "side", *(f"{axis}{k}" for k in range(21) for axis in "xy"), "score"])
    points = [(f"{20 + k}", f"{25 + k // 4}") for k in range(21)]
    rows = [
        ",".join([str(f), "right", *(v for point in points for v in point), "0.9"]) for f in range(FRAMES)
    ]
    return "\n".join([header, *rows]) + "\n"


def keypoints_tree() -> list[dict[str, Any]]:
    """The same as MediaPipe would give them."""
    points = [{"x": 0.3 + 0.01 * k, "y": 0.4, "z": 0.0, "visibility": 0.9} for k in range(21)]
    hand = {"landmarks": points, "handedness": {"label": "Right", "score": 0.9}}
    return [{"frame": f, "hands": [hand]} for f in range(FRAMES)]


def landmarks_csv() -> str:
    """Landmarks of the first frames, of both heads' recordings, in OpenFace's layout."""
    names = ["frame", "face_id", "confidence", "success"]
    names += [f"{axis}_{k}" for axis in "xy" for k in range(68)]
    points = [f"{20 + k % 17}" for k in range(68)] + [f"{15 + k % 13}" for k in range(68)]
    rows = [",".join([str(f + 1), "0", "0.9", "1", *points]) for f in range(FRAMES)]
    return "\n".join([", ".join(names), *rows]) + "\n"


def points_text() -> str:
    """The annotated points of one frame, as 300-VW has them."""
    points = "\n".join(f"{20 + k % 17}.5 {15 + k % 13}" for k in range(68))
    return f"version: 1\nn_points: 68\n{{\n{points}\n}}\n"


def landmarks_tree() -> list[dict[str, Any]]:
    """The same by our own names."""
    from posetrack_cli.head.face.points import POINT_NAMES

    points = {name: [20 + 2 * k, 15 + k, 0.0, 0.9] for k, name in enumerate(POINT_NAMES)}
    return [{"frame": f, "faces": [{"landmarks": points}]} for f in range(FRAMES)]


def truth_csv() -> str:
    from posetrack_cli.hand.model.anatomy import JOINT_NAMES

    header = ",".join(["stamp_ns", *(f"{name}_{axis}_mm" for name in JOINT_NAMES for axis in "xyz")])
    rows = [
        ",".join(
            [str(START_NS + k * PERIOD_NS), *(f"{j + 0.5 * k:.1f}" for j in range(3 * len(JOINT_NAMES)))]
        )
        for k in range(FRAMES)
    ]
    return "\n".join([header, *rows]) + "\n"


@cache
def video(suffix: str, fourcc: str) -> bytes:
    """Return a video of three small images of noise."""
    import tempfile

    rng = np.random.default_rng(0)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"v{suffix}"
        writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*fourcc), 30.0, (64, 48))
        for _ in range(FRAMES):
            writer.write(rng.integers(90, 160, (48, 64, 3), dtype=np.uint8))
        writer.release()
        return path.read_bytes()


@cache
def gif() -> bytes:
    """Return an animated GIF of three small images."""
    import tempfile

    import av

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "v.gif"
        with av.open(str(path), "w") as container:
            stream = container.add_stream("gif", rate=10)
            stream.width, stream.height, stream.pix_fmt = 64, 48, "rgb8"
            for image in _noise("rgb24"):
                container.mux(stream.encode(image.reformat(format="rgb8")))
            container.mux(stream.encode(None))
        return path.read_bytes()


@cache
def video_packets(codec: str) -> tuple[bytes, ...]:
    """Return a packet for each of three small images, as video in messages has them."""
    import av

    encoder: Any = av.CodecContext.create(codec, "w")
    encoder.width, encoder.height, encoder.pix_fmt = 64, 48, "yuv420p"
    encoder.time_base, encoder.max_b_frames = Fraction(1, 30), 0
    encoder.options = {"tune": "zerolatency", "x265-params": "repeat-headers=1:log-level=none"}
    images = [image.reformat(format="yuv420p") for image in _noise("rgb24")]
    return tuple(bytes(packet) for image in [*images, None] for packet in encoder.encode(image))


def _noise(form: str) -> Iterator[Any]:
    import av

    rng = np.random.default_rng(0)
    for number in range(FRAMES):
        image = av.VideoFrame.from_ndarray(rng.integers(90, 160, (48, 64, 3), dtype=np.uint8), format=form)
        image.pts = number
        yield image


@cache
def bag(kind: str) -> bytes:
    """Return a bag of a compression or a database, as rosbags writes them, or a file of a Kinect."""
    import tempfile

    from support.bags import write_bag, write_folder
    from support.kinect import write_kinect

    with tempfile.TemporaryDirectory() as folder:
        if kind == "mkv":
            return write_kinect(Path(folder) / "r.mkv").read_bytes()
        if kind == "db3":
            return (write_folder(Path(folder) / "r", "sqlite3") / "r.db3").read_bytes()
        return write_bag(Path(folder) / "r.bag", kind).read_bytes()


@cache
def glb() -> bytes:
    """Return our own hand as GLB, of few vertices."""
    from posetrack_cli.hand.model.anatomy import make_anatomy
    from posetrack_cli.hand.model.hand import hand_mesh
    from support.glb import hand_glb

    anatomy = make_anatomy()
    pose = np.concatenate([[0.0, 0.0, 800.0, 0.0, 0.0, 0.0, 1.0], np.zeros(15)])
    return hand_glb(anatomy, pose, mesh=hand_mesh(anatomy, "lean")).bytes()


def glb_bytes(text: bytes, binary: bytes) -> bytes:
    """Return a GLB container of a JSON text and a binary chunk."""
    text += b" " * (-len(text) % 4)
    binary += bytes(-len(binary) % 4)
    chunks = (
        struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    )
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def glb_parts(data: bytes) -> tuple[bytes, bytes]:
    """Return the JSON text and the binary chunk of a GLB container."""
    (length,) = struct.unpack_from("<I", data, 12)
    return data[20 : 20 + length], data[28 + length :]


def recording_of(messages_of: list[tuple[Record, Record, list[Record]]]) -> bytes:
    """Return a file of schemas with a channel and messages each, in one chunk."""
    inner = [r for schema, channel, own in messages_of for r in (schema, channel, *own)]
    return file_bytes([{"op": 1, "profile": "", "library": "x"}, {"op": CHUNK, "inner": inner}])
