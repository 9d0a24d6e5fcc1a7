"""The attacks that once worked, each a small file and a command, named after what they did."""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np

from hostile import bombs
from hostile import messages as ros
from hostile import seeds as of
from hostile.bombs import SPOILED_RECORDS
from hostile.case import Case, Content, Link, Pipe
from hostile.container_cases import matroska, matroska_bytes, pictures
from hostile.file_cases import (
    PLAYLISTS,
    npy_bytes,
    npy_of,
    npy_parts,
    npz_arrays,
    npz_bytes,
    png_file,
    resigned,
)
from hostile.mcap_bytes import CHANNEL, CHUNK, MESSAGE, METADATA, SCHEMA, Record, file_bytes, read_records
from hostile.seeds import Seeds
from hostile.targets import HAND, HEAD, OUT
from hostile.values import json_text, nested, utf8
from support.kinect import calibration

Builder = Callable[[Seeds], Case]
CORPUS: dict[str, Builder] = {}
OUTPUTS = (*OUT, "out.html", "out.npz", "out.toml", "v")
CALIBRATE = ("hand", "calibrate", "r.mcap", "-o", "out.toml")
RUN = ("hand", "run", "r.mcap", "-o", "out.mcap", *HAND)
MONO = ("head", "mono", "r.mcap", "-o", "out.mcap", *HEAD, "--passes", "1")
READING = {
    "info": ("info", "r.mcap"),
    "info json": ("info", "r.mcap", "--json", "-"),
    "convert": ("convert", "r.mcap", "-o", "out.mcap"),
    "convert images": ("convert", "r.mcap", "-o", "out.mcap", "--images"),
    "hand run": RUN,
    "head mono": MONO,
}
MEASURING = {
    "info": ("info", "r.mcap"),
    "info json": ("info", "r.mcap", "--json", "-"),
    "eval": ("eval", "r.mcap"),
    "export": ("export", "r.mcap"),
    "export protobuf": ("export", "r.mcap", "--schemas", "protobuf", "-o", "out.mcap"),
}


def add(name: str, command: tuple[str, ...], files: Callable[[Seeds], dict[str, Content]]) -> None:
    CORPUS[name] = lambda seeds: Case("corpus", command, files(seeds), OUTPUTS)


def add_recording(name: str, data: Callable[[Seeds], bytes], commands: dict[str, tuple[str, ...]]) -> None:
    for called, command in commands.items():
        add(f"{name}: {called}", command, lambda seeds: {"r.mcap": data(seeds)})


# 1. Code


CODE = 'string __import__("os").system("id>pwned");X=1\nuint8 data\n'


def of_one_message(
    schema: str, kind: str, encoding: str, text: bytes, data: bytes, topic: str = "/a"
) -> bytes:
    """Return a file of one schema, channel and message."""
    inner: list[Record] = [
        {"op": SCHEMA, "id": 1, "name": schema, "encoding": kind, "data": text},
        {"op": CHANNEL, "id": 1, "schema_id": 1, "topic": topic, "message_encoding": encoding},
        {"op": MESSAGE, "channel_id": 1, "log_time": 1, "publish_time": 1, "data": data},
    ]
    return file_bytes([{"op": 1}, {"op": CHUNK, "inner": inner}])


for _type in ("Image", "CompressedImage", "CameraInfo"):
    add_recording(
        f"ros1 code in sensor_msgs/{_type}",
        lambda _, t=_type: of_one_message(f"sensor_msgs/{t}", "ros1msg", "ros1", CODE.encode(), bytes(40)),
        READING if _type == "Image" else {"info": READING["info"]},
    )
add_recording(
    "ros2 code in sensor_msgs/Image",
    lambda _: of_one_message(
        "sensor_msgs/msg/Image", "ros2msg", "cdr", CODE.encode(), b"\0\1\0\0" + bytes(40)
    ),
    READING,
)
add_recording(
    "ros1 code in a nested type",
    lambda _: of_one_message(
        "sensor_msgs/Image",
        "ros1msg",
        "ros1",
        utf8(ros.definition(ros.image(1, 1, np.zeros((2, 2), np.uint16), "16UC1")) + CODE),
        ros.ros1_bytes(ros.image(1, 1, np.zeros((2, 2), np.uint16), "16UC1")),
    ),
    READING,
)


# 2. Memory and time


def of_one_chunk(compression: str, data: bytes, size: int) -> bytes:
    chunk = {"op": CHUNK, "compression": compression, "records": data, "uncompressed_size": size}
    return file_bytes([{"op": 1}, {**chunk, "uncompressed_crc": 0}])


BOMBS = READING | {"eval": ("eval", "r.mcap"), "export": ("export", "r.mcap")}
add_recording("9 KB of zstd, 300 MB", lambda _: of_one_chunk("zstd", bombs.zstd_zeros(300), 300 << 20), BOMBS)
add_recording(
    "131 KB of zstd, 4 GB", lambda _: of_one_chunk("zstd", bombs.zstd_zeros(4096), 4096 << 20), BOMBS
)
add_recording("zstd that states 1 KB", lambda _: of_one_chunk("zstd", bombs.zstd_zeros(4096), 1000), BOMBS)
add_recording("5 MB of lz4, 1.2 GB", lambda _: of_one_chunk("lz4", bombs.lz4_zeros(1200), 1200 << 20), BOMBS)
add_recording(
    "fifty zstd chunks of 200 MB",
    lambda _: file_bytes(
        [{"op": 1}]
        + [
            {
                "op": CHUNK,
                "records": bombs.zstd_zeros(200),
                "uncompressed_size": 200 << 20,
                "uncompressed_crc": 0,
                "message_start_time": k,
                "message_end_time": k,
            }
            for k in range(50)
        ]
    ),
    BOMBS,
)
add_recording(
    "a chunk of 60 MB of empty records",
    lambda _: file_bytes([{"op": 1}, {"op": CHUNK, "uncompressed": struct.pack("<BQ", 0x90, 0) * 7_000_000}]),
    BOMBS,
)


def _npz_case(command: tuple[str, ...], member: str) -> Callable[[Seeds], dict[str, Content]]:
    return lambda seeds: {"r.mcap": seeds.heads, "m.npz": bombs.npz_zeros(3200, member)}


ONE_CAMERA = (*MONO, "--cameras", "left")
STEREO = ("head", "stereo", "r.mcap", "-o", "out.mcap", *HEAD)
add(
    "npz of 3 MB to 3.2 GB as face model",
    (*ONE_CAMERA, "--face-model", "m.npz"),
    _npz_case(MONO, "header.npy"),
)
add(
    "npz of 3 MB to 3.2 GB as learned model",
    (*ONE_CAMERA, "--load-model", "m.npz"),
    _npz_case(MONO, "header.npy"),
)
add("npz of 3 MB to 3.2 GB of stereo", (*STEREO, "--load-model", "m.npz"), _npz_case(STEREO, "array.x.npy"))


def changed_glb(change: Callable[[dict[str, Any]], None]) -> Callable[[Seeds], dict[str, Content]]:
    """The hand as GLB with its JSON changed, beside a recording."""

    def files(seeds: Seeds) -> dict[str, Content]:
        text, binary = of.glb_parts(of.glb())
        content = json.loads(text)
        change(content)
        return {"r.mcap": seeds.hand, "m.glb": of.glb_bytes(json.dumps(content).encode(), binary)}

    return files


def _stride_zero(content: dict[str, Any]) -> None:
    for accessor in content["accessors"]:
        accessor["count"] = 100_000_000
    for view in content["bufferViews"]:
        view["byteStride"] = 0


def _long_chain(content: dict[str, Any]) -> None:
    first = len(content["nodes"])
    content["nodes"] += [{"children": [first + k + 1]} for k in range(20_000)] + [{}]
    content["nodes"][0]["children"] = [first]


def _loop(content: dict[str, Any]) -> None:
    content["nodes"][1]["children"] = [1]


def _scaled(scale: float) -> Callable[[dict[str, Any]], None]:
    def change(content: dict[str, Any]) -> None:
        for node in content["nodes"]:
            node["scale"] = [scale] * 3

    return change


MESH = (*RUN[:-1], "1", "--hand-mesh", "m.glb")
add("GLB of byteStride 0 and count 1e8", MESH, changed_glb(_stride_zero))
add("GLB with a chain of 20,000 nodes", MESH, changed_glb(_long_chain))
add("GLB with a node that is its own child", MESH, changed_glb(_loop))
add("GLB of scale 1e300", MESH, changed_glb(_scaled(1e300)))
add("GLB of scale 0", MESH, changed_glb(_scaled(0.0)))


def images_folder(name: str, data: bytes, *, grey: bool = False) -> Callable[[Seeds], dict[str, Content]]:
    """A folder of images one of which is another."""

    def files(seeds: Seeds) -> dict[str, Content]:
        folder = of.grey_folder(seeds) if grey else of.depth_folder(seeds)
        return {**folder, name: data}

    return files


FOLDER = {
    "info": ("info", "rec"),
    "convert": ("convert", "rec", "-o", "out.mcap"),
    "run": ("hand", "run", "rec", *RUN[3:]),
}
for _called, _command in FOLDER.items():
    add(
        f"PNG of 20000 x 20000: {_called}",
        _command,
        lambda seeds: images_folder("rec/000001.png", bombs.png_zeros(20000, 16))(seeds),
    )
    add(
        f"PNG that states 2^31: {_called}",
        _command,
        lambda seeds: images_folder("rec/000000.png", _stated(2**31 - 1))(seeds),
    )
for _called, _command in {"info": ("info", "rec"), "stereo": ("head", "stereo", "rec", *STEREO[3:])}.items():
    add(
        f"grey PNG of 20000 x 20000: {_called}",
        _command,
        lambda seeds: images_folder("rec/left/000001.png", bombs.png_zeros(20000, 8), grey=True)(seeds),
    )


def _stated(side: int) -> bytes:
    return png_file(side, side, 16, 0, zlib.compress(bytes(100)))


# 3. Tracebacks


def ros_recording(version: int, change: Callable[[str, ros.Layout], ros.Layout]) -> Callable[[Seeds], bytes]:
    """A recording of depth as ROS messages, each type's fields changed."""

    def build(seeds: Seeds) -> bytes:
        rows, columns = seeds.depth.shape[1:]
        images = [change("Image", ros.image(version, 10 + k, i, "16UC1")) for k, i in enumerate(seeds.depth)]
        infos = [change("CameraInfo", ros.camera_info(version, 9, columns, rows))]
        inner: list[Record] = []
        package = "sensor_msgs/" if version == 1 else "sensor_msgs/msg/"
        codes = ("ros1msg", "ros1") if version == 1 else ("ros2msg", "cdr")
        for number, (kind, topic, layouts) in enumerate(
            (("Image", "/cam/image", images), ("CameraInfo", "/cam/camera_info", infos)), 1
        ):
            text = utf8(ros.definition(layouts[0]))
            inner.append(
                {"op": SCHEMA, "id": number, "name": package + kind, "encoding": codes[0], "data": text}
            )
            channel = {"op": CHANNEL, "id": number, "schema_id": number, "topic": topic}
            inner.append({**channel, "message_encoding": codes[1]})
            for k, layout in enumerate(layouts):
                data = ros.ros1_bytes(layout) if version == 1 else ros.cdr_bytes(layout)
                inner.append(
                    {"op": MESSAGE, "channel_id": number, "log_time": k, "publish_time": k, "data": data}
                )
        return file_bytes([{"op": 1}, {"op": CHUNK, "inner": inner}])

    return build


def _without(kind: str, name: str) -> Callable[[str, ros.Layout], ros.Layout]:
    return lambda k, layout: tuple(f for f in layout if k != kind or f.name != name)


def _only_a(kind: str) -> Callable[[str, ros.Layout], ros.Layout]:
    return lambda k, layout: (ros.Field("uint8", "a", 1),) if k == kind else layout


for _version in (1, 2):
    for _kind, _fields in (
        ("Image", ("header", "height", "encoding", "step", "data")),
        ("CameraInfo", ("header", "width", "distortion_model", "K", "k", "D", "d")),
    ):
        add_recording(
            f"ROS {_version} {_kind} with text 'uint8 a'",
            ros_recording(_version, _only_a(_kind)),
            {name: READING[name] for name in ("info", "convert")},
        )
        for _field in _fields:
            add_recording(
                f"ROS {_version} {_kind} without {_field}",
                ros_recording(_version, _without(_kind, _field)),
                {name: READING[name] for name in ("info", "convert")},
            )


def changed_metadata(kind: str, record: str, key: str, value: Any) -> Callable[[Seeds], bytes]:
    """A result in which one entry of a metadata record is another."""

    def build(seeds: Seeds) -> bytes:
        records = read_records(seeds.results[kind])
        for found in of.every(records):
            if found["op"] == METADATA and found["name"] == record:
                found["metadata"] = {
                    **found["metadata"],
                    key: value if isinstance(value, str) else json_text(value),
                }
        return file_bytes(records)

    return build


for _depth in (900, 100_000):
    add_recording(
        f"a subject nested {_depth} deep",
        changed_metadata("hand", "posetrack.subject", "triangles", "[" * _depth + "]" * _depth),
        MEASURING,
    )
    add_recording(
        f"cameras nested {_depth} deep",
        changed_metadata("stereo", "posetrack.cameras", "cameras", "[" * _depth + "]" * _depth),
        MEASURING,
    )
SUBJECT_VALUES: dict[str, tuple[str, Any]] = {
    "a shape name that is a list": ("shape_names", [["a"], ["b"]]),
    "a shape name that is an object": ("shape_names", [{"a": 1}]),
    "point names that are numbers": ("point_names", [1, 2, None]),
    "parents beyond the points": ("point_parents", [10**30, -5, "a"]),
    "triangles beyond the vertices": ("triangles", [[0, 1, 2**62]]),
    "a colour of text": ("colour", ["a", None, [], {}]),
    "a name that is an escape": ("name", "\x1b]0;pwned\x07"),
    "a name that is a list": ("name", [[]]),
    "no names": ("shape_names", []),
    "a million names": ("point_names", [f"p{k}" for k in range(1_000_000)]),
}
for _name, (_key, _value) in SUBJECT_VALUES.items():
    add_recording(_name, changed_metadata("hand", "posetrack.subject", _key, _value), MEASURING)
CAMERA_VALUES: dict[str, Any] = {
    "cameras that are numbers": [1, 2],
    "cameras that are empty": [],
    "a camera that is empty": [{}],
    "a camera of text": [{"width": "a", "height": [], "fx": None, "distortion": 1, "camera_T_reference": 5}],
    "a place nested": [{"camera_T_reference": nested(900, False), "distortion": []}],
}
for _name, _value in CAMERA_VALUES.items():
    add_recording(_name, changed_metadata("stereo", "posetrack.cameras", "cameras", _value), MEASURING)
for _name, _value in {
    "escapes": "\x1b[2J\x9b2J\u202e",
    "nested": "[" * 100_000,
    "numbers": "1e999",
    "none": "",
}.items():
    for _key in ("configuration", "version", "seed", "renderer", "input.name", "tracker"):
        add_recording(
            f"run record: {_key} of {_name}",
            changed_metadata("hand", "posetrack.run", _key, _value),
            {name: MEASURING[name] for name in ("info", "eval")},
        )
DEEP_TOML = {
    "[[[[": b"fx = 45.0\nfy = 45.0\ncx = 31.5\ncy = 26.0\nx = " + b"[" * 5000,
    "{{{{": b"x = " + b"{a=" * 5000,
    "dots": b"a" + b".a" * 20_000 + b" = 1",
    "closed": b"fx = 45.0\nfy = 45.0\ncx = 31.5\ncy = 26.0\nx = " + b"[" * 300 + b"]" * 300,
    "surrogates": b'fx = "\\ud800"',
    "bytes": b"\xff\xfe\0\0",
}
for _name, _text in DEEP_TOML.items():
    for _called, _command in FOLDER.items():
        add(
            f"camera.toml of {_name}: {_called}",
            _command,
            lambda seeds, text=_text: {**of.depth_folder(seeds), "rec/camera.toml": text},
        )
    add(
        f"rig of {_name}",
        ("info", "rec"),
        lambda seeds, text=_text: {**of.grey_folder(seeds), "rec/camera.toml": text},
    )
    add(
        f"configuration of {_name}",
        (*ONE_CAMERA, "--config", "c.toml"),
        lambda seeds, text=_text: {"r.mcap": seeds.heads, "c.toml": text},
    )
    add(
        f"shape of {_name}",
        (*RUN[:5], "--shape", "c.toml"),
        lambda seeds, text=_text: {"r.mcap": seeds.hand, "c.toml": text},
    )
    add(
        f"pose of {_name}",
        (*RUN[:5], *HAND[:6], "--init", "c.toml", "--end", "1"),
        lambda seeds, text=_text: {"r.mcap": seeds.hand, "c.toml": text},
    )


for _called, _numbers in {
    "a million": "[" + "0.0," * 1_000_000 + "]",
    "many lists": "[" * 90 + "]" * 90,
    "inf": "[inf]",
    "nan": "[0.0, nan]",
    "1e308": "[1e308, -1e308]",
    "words": '["a", "b"]',
    "a table": "{ a = 1 }",
}.items():
    add(
        f"coefficients of {_called}",
        (*RUN[:5], "--shape", "c.toml"),
        lambda seeds, n=_numbers: {"r.mcap": seeds.hand, "c.toml": f"[hand]\ncoefficients = {n}\n".encode()},
    )


def float_depth(value: float) -> Callable[[Seeds], bytes]:
    """Depth as 32FC1 metres, all of one value."""

    def change(kind: str, layout: ros.Layout) -> ros.Layout:
        if kind != "Image":
            return layout
        return ros.image(2, 10, np.full((53, 64), value, np.float32), "32FC1")

    return ros_recording(2, change)


for _value in (1e30, 1e38, 1e-38, -1.0, float("inf"), float("nan")):
    add_recording(
        f"32FC1 depth of {_value:g}",
        float_depth(_value),
        {k: READING[k] for k in ("info", "convert", "hand run")} | {"hand calibrate": CALIBRATE},
    )


# 3 and 4. States and models


def damaged_npz(data: bytes) -> Iterator[tuple[str, bytes]]:
    """Yield ways to damage an npz file: each array gone, or of another shape, type or number."""
    arrays = npz_arrays(data)

    def other(name: str, content: bytes) -> bytes:
        return npz_bytes([(n, content if n == name else c) for n, c in arrays.items()])

    for name, content in arrays.items():
        yield f"without {name}", npz_bytes([(n, c) for n, c in arrays.items() if n != name])
        yield f"{name} empty", other(name, npy_of(np.zeros((0, 3))))
        yield f"{name} a number", other(name, npy_of(np.array(5.0)))
        yield f"{name} of text", other(name, npy_of(np.array(["\x1b[2J", "b"])))
        head, body = npy_parts(content)
        yield f"{name} of objects", other(name, npy_bytes(str({**head, "descr": "|O"}), body))
        yield f"{name} of 2^62", other(name, npy_bytes(str({**head, "shape": (2**62,)}), body))
        if head["descr"][1:] in ("f8", "f4") and body:
            nan = np.full(len(body) // int(head["descr"][2:]), np.nan, head["descr"])
            yield f"{name} of NaN", other(name, npy_bytes(str(head), nan.tobytes()))
            yield f"{name} of 1e30", other(name, npy_bytes(str(head), (np.ones_like(nan) * 1e30).tobytes()))
    yield "cut", data[: len(data) // 2]
    yield "empty", b""
    yield "no zip", b"\x80\x04\x95cos\nsystem\n(S'id>pwned'\ntR."


JSON_CHANGES: dict[str, Callable[[Any], Any]] = {
    "a list": lambda _: [],
    "null": lambda _: None,
    "nested": lambda _: nested(900, True),
    "text numbers": lambda tree: _mapped(tree, str),
    "huge numbers": lambda tree: _mapped(tree, lambda n: 10**30 if isinstance(n, int) else 1e300),
    "negative numbers": lambda tree: _mapped(tree, lambda n: -1),
    "no numbers": lambda tree: _mapped(tree, lambda n: None),
    "plus one": lambda tree: _mapped(tree, lambda n: n + 1),
}


def _mapped(tree: Any, change: Callable[[Any], Any]) -> Any:
    """Every number of a tree but the format's version changed."""
    if isinstance(tree, dict):
        return {key: value if key == "version" else _mapped(value, change) for key, value in tree.items()}
    if isinstance(tree, list):
        return [_mapped(value, change) for value in tree]
    return change(tree) if isinstance(tree, (int, float)) and not isinstance(tree, bool) else tree


def damaged_json(data: bytes, member: str) -> Iterator[tuple[str, bytes]]:
    """Yield ways to change the JSON text that an npz file keeps as bytes or as text."""
    arrays = npz_arrays(data)
    head, body = npy_parts(arrays[member])
    as_bytes = "u1" in head["descr"]
    tree = json.loads(body if as_bytes else body.decode("utf-32-le"))
    fields: list[tuple[str, Any]] = [(name, change(tree)) for name, change in JSON_CHANGES.items()]
    for key in tree:
        fields.append((f"without {key}", {k: v for k, v in tree.items() if k != key}))
        if isinstance(tree[key], dict):
            fields += [(f"without {key}.{k}", {**tree, key: _but(tree[key], k)}) for k in tree[key]]
            for k, inner in tree[key].items():
                if isinstance(inner, dict):
                    fields += [
                        (f"without {key}.{k}.{i}", {**tree, key: {**tree[key], k: _but(inner, i)}})
                        for i in inner
                    ]
    for name, changed in fields:
        text = json_text(changed)
        array = np.frombuffer(text.encode(), np.uint8) if as_bytes else np.array(text)
        yield (
            f"JSON: {name}",
            npz_bytes([(n, npy_of(array) if n == member else c) for n, c in arrays.items()]),
        )


def _but(mapping: dict[str, Any], key: str) -> dict[str, Any]:
    return {k: v for k, v in mapping.items() if k != key}


# 5. What terminals obey


ESCAPES = "\x1b]0;pwned\x07\x1b[2J\x9b31m\u202egpj\u2066"
for _place in ("topic", "schema", "encoding", "message encoding", "metadata", "attachment"):

    def _escaped(seeds: Seeds, place: str = _place) -> bytes:
        records = read_records(seeds.hand)
        for record in of.every(records):
            if record["op"] == CHANNEL and place == "topic":
                record["topic"] += ESCAPES
            elif record["op"] == CHANNEL and place == "message encoding":
                record["message_encoding"] += ESCAPES
            elif record["op"] == SCHEMA and place == "schema":
                record["name"] += ESCAPES
            elif record["op"] == SCHEMA and place == "encoding":
                record["encoding"] += ESCAPES
        if place == "metadata":
            records.append({"op": METADATA, "name": ESCAPES, "metadata": {ESCAPES: ESCAPES}})
        if place == "attachment":
            records.append({"op": 9, "name": ESCAPES, "media_type": ESCAPES, "data": b"x"})
        return file_bytes(records)

    add_recording(f"escapes in {_place}", _escaped, READING)
NAME = "a\x1b]0;pwned\x07\u202e.mcap"
for _called, _command in MEASURING.items():
    _words = tuple(NAME if word == "r.mcap" else word for word in _command)
    add(f"a result's name with escapes: {_called}", _words, lambda seeds: {NAME: seeds.results["hand"]})
    add(f"a name of bytes with escapes: {_called}", _words, lambda seeds: {NAME: b"x"})
add(
    "cameras whose folders are escapes",
    ("info", "rec"),
    lambda seeds: {f"rec/{c}\x1b[2J\u202e/0.png": of.png(seeds.grey[0]) for c in "ab"},
)


# 6. Files that are none, and what libraries say


for _called, _special in {"pipe": Pipe(), "device": Link("/dev/zero"), "folder loop": Link("r.mcap")}.items():
    for _name, _command in (READING | MEASURING).items():
        add(f"a {_called} as recording: {_name}", _command, lambda seeds, s=_special: {"r.mcap": s})
    for _option, _command in {
        "--camera": ("convert", "rec", "-o", "out.mcap", "--camera", "x"),
        "--truth": ("convert", "rec", "-o", "out.mcap", "--truth", "x"),
        "--config": ("hand", "run", "rec", "-o", "out.mcap", "--config", "x"),
        "--init": ("hand", "run", "rec", "-o", "out.mcap", "--init", "x"),
        "--shape": ("hand", "run", "rec", "-o", "out.mcap", "--shape", "x"),
        "--hand-mesh": ("hand", "run", "rec", "-o", "out.mcap", "--hand-mesh", "x"),
        "--face-model": ("head", "mono", "rec", "-o", "out.mcap", "--face-model", "x"),
        "--load-model": ("head", "mono", "rec", "-o", "out.mcap", "--load-model", "x"),
        "clicked": ("head", "mono", "rec", "-o", "out.mcap", "--init", "x"),
        "--gates": ("eval", "r.mcap", "--gates", "x"),
        "--baseline": ("eval", "r.mcap", "--baseline", "x"),
        "truth of eval": ("eval", "r.mcap", "--truth", "x"),
        "recording of eval": ("eval", "r.mcap", "--recording", "x"),
    }.items():
        add(
            f"a {_called} as {_option}",
            _command,
            lambda seeds, s=_special, c=_command: {
                "x": s,
                **({"r.mcap": seeds.results["hand"]} if "r.mcap" in c else of.depth_folder(seeds)),
            },
        )
    for _file in ("camera.toml", "timestamps.csv", "000001.png"):
        for _name, _command in FOLDER.items():
            add(
                f"a {_called} as {_file}: {_name}",
                _command,
                lambda seeds, s=_special, f=_file: {**of.depth_folder(seeds), f"rec/{f}": s},
            )
for _place in ("out.mcap", "out.mcap.part", "out.mcap.part.state", "out.mcap.part.state.tmp"):
    for _called, _command in {"convert": READING["convert"], "hand run": RUN}.items():
        CORPUS[f"a link as {_place}: {_called}"] = lambda seeds, p=_place, c=_command: Case(
            "corpus",
            (*c, "--overwrite"),
            {"r.mcap": seeds.hand, p: Link("victim"), "victim": b"kept"},
            OUTPUTS,
        )
SPOILED = {
    "PNG": (".png", lambda data: data[:60] + b"\xff" * 30 + data[90:]),
    "cut PNG": (".png", lambda data: data[: len(data) // 2]),
    "TIFF": (".tiff", lambda data: data[:60] + b"\xff" * 30 + data[90:]),
    "cut TIFF": (".tiff", lambda data: data[: len(data) // 2]),
    "JPEG": (".jpg", lambda data: data[:200] + b"\xff" * 200 + data[400:]),
    "cut JPEG": (".jpg", lambda data: data[: len(data) // 2]),
    "WebP": (".webp", lambda data: data[:40] + b"\xff" * 30 + data[70:]),
}
for _name, (_suffix, _spoil) in SPOILED.items():
    for _called, _command in {
        "info": ("info", "rec"),
        "stereo": ("head", "stereo", "rec", *STEREO[3:]),
    }.items():

        def _spoiled(seeds: Seeds, suffix: str = _suffix, spoil: Any = _spoil) -> dict[str, Content]:
            files = {n: c for n, c in of.grey_folder(seeds).items() if not n.endswith(".png")}
            for camera in ("left", "right"):
                files |= {
                    f"rec/{camera}/{k:06d}{suffix}": of.encoded(suffix, image)
                    for k, image in enumerate(seeds.grey)
                }
            files["rec/timestamps.csv"] = of.stamps_csv().replace(".png", suffix).encode()
            return {**files, f"rec/left/000001{suffix}": spoil(files[f"rec/left/000001{suffix}"])}

        add(f"damaged {_name}: {_called}", _command, _spoiled)
for _called, _data in {
    "one page again and again": bombs.tiff_of_one_page,
    "directories that overlap": bombs.tiff_of_overlapping_directories,
}.items():
    for _name, _command in FOLDER.items():
        add(
            f"TIFF with {_called}: {_name}",
            _command,
            lambda seeds, data=_data: {"rec/camera.toml": of.CAMERA_TOML.encode(), "rec/a.tif": data()},
        )
for _number, _text in enumerate(PLAYLISTS):
    for _suffix in (".avi", ".mp4"):
        for _called, _command in {
            "info": ("info", f"v{_suffix}"),
            "mono": ("head", "mono", f"v{_suffix}", *MONO[3:]),
        }.items():
            add(
                f"playlist {_number}{_suffix}: {_called}",
                _command,
                lambda seeds, t=_text, s=_suffix: {f"v{s}": utf8(t), "other.avi": of.video(".avi", "MJPG")},
            )
for _suffix, _code in ((".avi", "MJPG"), (".mp4", "mp4v")):
    for _share in (0.3, 0.6, 0.9):
        add(
            f"video cut at {_share}{_suffix}",
            ("info", f"v{_suffix}"),
            lambda seeds, s=_suffix, c=_code, share=_share: {
                f"v{s}": of.video(s, c)[: int(share * len(of.video(s, c)))]
            },
        )


def bag_case(name: str, data: Callable[[], bytes], suffix: str) -> None:
    for called, words in {"info": ("info",), "convert": ("convert", "-o", "out.mcap")}.items():
        command = (words[0], f"r{suffix}", *words[1:])
        add(f"{name}: {called}", command, lambda seeds: {f"r{suffix}": data()})


bag_case("bag that is a bomb", bombs.bag, ".bag")
for _called, _statements in bombs.DATABASES.items():
    bag_case(f"database with {_called}", lambda statements=_statements: bombs.database(statements), ".db3")


for _called, _record in SPOILED_RECORDS.items():
    bag_case(f"bag with {_called} outside chunks", lambda record=_record: bombs.bag_of(record), ".bag")
bag_case("database whose topics are text", lambda: bombs.database(bombs.TEXT_TOPICS), ".db3")
bag_case(
    "database of names that are not UTF-8",
    lambda: bombs.database(bombs.TEXT_TOPICS).replace(b"CREATE TABLE topics", b"CREATE " + b"\xff" * 12),
    ".db3",
)
for _called, _text in {"one word": "a" * 400_000, "endings": ".db3" * 100_000}.items():
    add(
        f"metadata.yaml of {_called}",
        ("info", "r"),
        lambda seeds, text=_text: {"r/metadata.yaml": text.encode(), "r/r_0.mcap": seeds.hand},
    )
for _number in range(3, len(pictures())):
    for _name, _command in {"convert": READING["convert"], "hand run": RUN}.items():
        add(
            f"Kinect whose second frame is picture {_number}: {_name}",
            tuple("r.mkv" if word == "r.mcap" else word for word in _command),
            lambda seeds, number=_number: {
                "r.mkv": matroska_bytes(
                    matroska(
                        (pictures()[0], pictures()[number], pictures()[1]), json.dumps(calibration()).encode()
                    )
                )
            },
        )


# All of them


def damaged_states(seeds: Seeds, kind: str) -> list[tuple[str, Callable[[], bytes]]]:
    """Return what makes damaged states of an interrupted run, with digests that fit and without.

    Few of them are asked for in ``scripts/test``, and to sign all takes seconds.
    """
    state = seeds.interrupted[kind][1]
    unsigned = list(damaged_json(state, "json.npy"))
    signed = [*damaged_npz(state), *unsigned]
    return [
        *((name, partial(bytes, data)) for name, data in unsigned),
        *((f"{name}, signed", partial(resigned, data)) for name, data in signed),
    ]


def state_case(seeds: Seeds, kind: str, state: bytes) -> Case:
    """Return the command that resumes a run by a state."""
    recording: dict[str, Content] = {"hand.mcap": seeds.hand, "heads.mcap": seeds.heads}
    command = (*seeds.commands[kind], "-o", "out.mcap", "--resume")
    files = {name: data for name, data in recording.items() if name in command}
    parts = {"out.mcap.part": seeds.interrupted[kind][0], "out.mcap.part.state": state}
    return Case("states", command, {**files, **parts}, OUT)


def model_cases(seeds: Seeds) -> Iterator[tuple[str, Case]]:
    """Yield runs that are given damaged models."""
    tail = ("heads.mcap", "-o", "out.mcap", *HEAD)
    mono = ("head", "mono", *tail, "--cameras", "left", "--passes", "1")
    options: dict[str, tuple[tuple[str, ...], bytes]] = {
        "mono": ((*mono, "--load-model", "m.npz"), seeds.models["mono"]),
        "stereo": (("head", "stereo", *tail, "--load-model", "m.npz"), seeds.models["stereo"]),
        "face": ((*mono, "--face-model", "m.npz"), seeds.face_model),
    }
    for kind, (command, data) in options.items():
        for name, damaged in [*damaged_npz(data), *damaged_json(data, "header.npy")]:
            files: dict[str, Content] = {"heads.mcap": seeds.heads, "m.npz": damaged}
            yield f"{kind}: {name}", Case("models", command, files, OUT)


def every_case(seeds: Seeds) -> Iterator[Case]:
    """Yield all attacks, and all damaged states and models."""
    for build in CORPUS.values():
        yield build(seeds)
    for kind in seeds.interrupted:
        for _, make in damaged_states(seeds, kind):
            yield state_case(seeds, kind, make())
    for _, case in model_cases(seeds):
        yield case
