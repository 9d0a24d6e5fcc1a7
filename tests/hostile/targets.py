"""What is attacked: for each target a strategy of cases, made from seeds."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import numpy as np
from hypothesis import strategies as st

from hostile import messages as ros
from hostile import seeds as of
from hostile.case import Case, Content, Link, Pipe
from hostile.container_cases import changed_bag, changed_database, changed_matroska, changed_metadata
from hostile.file_cases import (
    changed_glb,
    changed_image,
    changed_npz,
    changed_stack,
    changed_video,
    resigned,
)
from hostile.mcap_bytes import (
    CHANNEL,
    CHUNK,
    MESSAGE,
    METADATA,
    SCHEMA,
    Record,
    file_bytes,
    read_records,
)
from hostile.mcap_cases import changed_file
from hostile.seeds import Seeds, messages
from hostile.values import (
    changed_bytes,
    changed_text,
    changed_tree,
    composite,
    json_text,
    one_of,
    texts,
    utf8,
)
from support import datasets as layouts
from support.onnx_file import yunet_like
from support.rvl import encoded as encoded_rvl

Strategy = st.SearchStrategy[Case]
OUT = ("out.mcap",)
EXPORTED = ("out.npz", "out.c3d", "out.parquet", "out.nwb", "study")
START_S = 1_305_031_102
"""Seconds since 1970, in names of images."""
HAND = ("--particles", "4", "--hand-side", "right", "--shape", "average", "--init", "center", "--end", "2")
OUT_OF_HAND = ("-o", "out.mcap", *HAND)
HEAD = ("--particles", "10", "--end", "2")


def commands(*weighted: tuple[int, tuple[str, ...]]) -> st.SearchStrategy[tuple[str, ...]]:
    """One of some command lines, the earlier of equal weights the simpler."""
    return st.sampled_from([command for weight, command in weighted for _ in range(weight)])


def of_recording(name: str, *, depth: bool = True, heads: bool = True) -> st.SearchStrategy[tuple[str, ...]]:
    """Commands that read a recording; those that track are rare, as they take long."""
    choices = [(6, ("info", name)), (6, ("info", name, "--json", "-"))]
    if depth:
        choices += [
            (6, ("convert", name, "-o", "out.mcap")),
            (1, ("hand", "run", name, "-o", "out.mcap", *HAND)),
        ]
    if heads:
        choices.append((2, ("convert", name, "-o", "out.mcap", "--images")))
        choices.append((3, ("head", "mono", name, "-o", "out.mcap", *HEAD, "--passes", "1")))
        choices.append((2, ("head", "stereo", name, "-o", "out.mcap", *HEAD)))
    return commands(*choices)


def of_result(name: str) -> st.SearchStrategy[tuple[str, ...]]:
    return commands(
        (4, ("info", name)),
        (3, ("info", name, "--json", "-")),
        (3, ("eval", name)),
        (1, ("eval", name, "--parts")),
        (1, ("eval", name, "--json", "-")),
        (1, ("eval", name, "--html", "out.html")),
        (2, ("eval", name, "--mcap", "out.mcap")),
        (1, ("eval", name, "--rows", "--html", "out.html", "--markdown", "-")),
        (2, ("export", name)),
        (2, ("export", name, "--format", "json")),
        (1, ("export", name, "-o", "out.npz")),
        (1, ("export", name, "--format", "tum")),
        (1, ("export", name, "--format", "bvh")),
        (1, ("export", name, "-o", "out.c3d")),
        (1, ("export", name, "-o", "out.parquet")),
        (1, ("export", name, "-o", "out.nwb", "--session-start", "2026-01-31T10:00:00Z")),
        (1, ("export", name, "-o", "study/sub-01_task-reach_motion.tsv")),
        (1, ("export", name, "--format", "rom")),
        (1, ("export", name, "--format", "openface")),
        (1, ("export", name, "--format", "arkit")),
        (1, ("export", name, "--format", "mediapipe")),
        (1, ("export", name, "--schemas", "ros2", "-o", "out.mcap")),
        (1, ("export", name, "--schemas", "protobuf", "-o", "out.mcap")),
    )


def made_of(
    target: str, name: str, content: st.SearchStrategy[bytes], command: Any, **files: Content
) -> Strategy:
    """Cases of one changed file beside others."""
    return st.builds(
        lambda data, words: Case(
            target, words, {name: data, **files}, (*OUT, *EXPORTED, "out.html", "v", "out.toml")
        ),
        content,
        command,
    )


# Recordings


def mcap(seeds: Seeds) -> Strategy:
    """MCAP records of recordings and results."""
    name = "r.mcap"
    records = [read_records(data) for data in (seeds.hand, seeds.heads)]
    results = [read_records(data) for data in seeds.results.values()]
    return st.one_of(
        made_of("mcap", name, one_of(records).flatmap(changed_file), of_recording(name)),
        made_of("mcap", name, one_of(records).flatmap(changed_file), of_recording(name)),
        made_of("mcap", name, one_of(results).flatmap(changed_file), of_result(name)),
        made_of(
            "mcap",
            name,
            one_of([*seeds.results.values(), seeds.hand]).flatmap(changed_bytes),
            of_result(name),
        ),
    )


def _ros(seeds: Seeds, version: int) -> Strategy:
    name = "r.mcap"
    depth, grey = seeds.depth, seeds.grey
    rows, columns = depth.shape[1:]
    raw = [ros.image(version, 10 + k, image, "16UC1") for k, image in enumerate(depth)]
    packed = [ros.compressed_image(version, 10 + k, of.png(image), "png") for k, image in enumerate(grey)]
    head = b"\0" * 12
    deep = [
        ros.compressed_image(version, 10 + k, head + of.png(image), "16UC1; compressedDepth png")
        for k, image in enumerate(depth)
    ]
    runs = [
        ros.compressed_image(version, 10 + k, head + encoded_rvl(image), "16UC1; compressedDepth rvl")
        for k, image in enumerate(depth)
    ]
    with np.errstate(divide="ignore"):
        apart = [np.where(image > 0, 3375.0 / image, -1.0).astype(np.float32) for image in depth]
    disparity = [ros.disparity_image(version, 10 + k, image) for k, image in enumerate(apart)]
    pixels = [ros.image(version, 10 + k, image, "32FC1") for k, image in enumerate(apart)]
    info = [ros.camera_info(version, 9, columns, rows)]
    whole = {
        "raw": {"/cam/image": ("sensor_msgs/Image", raw)},
        "deep": {"/cam/image": ("sensor_msgs/CompressedImage", deep)},
        "grey": {"/cam/image": ("sensor_msgs/CompressedImage", packed)},
        "runs": {"/cam/image/compressedDepth": ("sensor_msgs/CompressedImage", runs)},
        "disparity": {"/cam/image": ("stereo_msgs/DisparityImage", disparity)},
        "pixels": {"/cam/disparity": ("sensor_msgs/Image", pixels)},
    }
    more = {
        "/cam/camera_info": ("sensor_msgs/CameraInfo", info),
        "/tf": ("tf2_msgs/TFMessage", [ros.transforms(version, 9)]),
    }
    topics = one_of([whole[kind] | more for kind in ("raw", "deep", "grey", "runs", "disparity", "pixels")])
    content = topics.flatmap(lambda chosen: ros.ros_records(version, chosen)).map(
        lambda inner: file_bytes([{"op": 1}, {"op": CHUNK, "inner": inner}])
    )
    return made_of(f"ros{version}", name, content, of_recording(name))


def ros1(seeds: Seeds) -> Strategy:
    """ROS 1 messages and their texts."""
    return _ros(seeds, 1)


def ros2(seeds: Seeds) -> Strategy:
    """ROS 2 messages and their texts."""
    return _ros(seeds, 2)


def protobuf(seeds: Seeds) -> Strategy:
    """Foxglove messages, and their schemas."""
    name = "r.mcap"

    @composite
    def content(draw: st.DrawFn) -> bytes:
        records = read_records(draw(one_of((seeds.hand, seeds.heads, *seeds.results.values()))))
        schemas = {r["id"]: r for r in of.every(records) if r["op"] == SCHEMA}
        kinds = of.message_types(records)
        own = [m for m in messages(records) if kinds[m["channel_id"]].startswith("foxglove.")]
        if draw(st.integers(0, 3)) == 0:
            chosen = draw(st.sampled_from([s for s in schemas.values() if s["encoding"] == "protobuf"]))
            chosen["data"] = draw(
                st.one_of(ros.changed_descriptor(chosen["data"]), changed_bytes(chosen["data"]))
            )
        else:
            places = st.lists(st.integers(0, len(own) - 1), min_size=1, max_size=2, unique=True)
            for message in (own[k] for k in draw(places)):
                parsed = _foxglove(kinds[message["channel_id"]]).FromString(message["data"])
                message["data"] = draw(ros.changed_protobuf(parsed))
        return file_bytes(records)

    either = st.one_of(of_recording(name), of_recording(name), of_result(name))
    return made_of("protobuf", name, content(), either)


def _foxglove(name: str) -> Any:
    import importlib

    short = name.removeprefix("foxglove.")
    return getattr(importlib.import_module(f"foxglove_schemas_protobuf.{short}_pb2"), short)


# Results


def results(seeds: Seeds) -> Strategy:
    """Metadata records, estimates and truth of results."""
    name = "r.mcap"

    @composite
    def content(draw: st.DrawFn) -> bytes:
        records = read_records(draw(one_of(seeds.results.values())))
        kinds = of.message_types(records)
        own = [m for m in messages(records) if kinds[m["channel_id"]] == "posetrack.Estimate"]
        about = [r for r in of.every(records) if r["op"] == METADATA]
        for _ in range(draw(st.integers(1, 3))):
            if draw(st.integers(0, 2)):
                _change_metadata(draw, draw(one_of(about)))
            else:
                _change_estimate(draw, own)
        return file_bytes(records)

    return made_of("results", name, content(), of_result(name))


def _change_metadata(draw: st.DrawFn, record: Record) -> None:
    """A value of a record; where it is JSON something within it."""
    values = record["metadata"] = dict(record["metadata"])
    if not values or draw(st.integers(0, 7)) == 0:
        values[draw(texts())] = draw(texts())
        return
    key = draw(st.sampled_from(sorted(values)))
    how = draw(st.sampled_from(("json", "json", "json", "text", "drop")))
    if how == "drop":
        del values[key]
    elif how == "text":
        values[key] = draw(texts())
    else:
        try:
            tree = json.loads(values[key])
        except (ValueError, RecursionError):
            tree = values[key]
        values[key] = json_text(draw(changed_tree(tree)))


def _change_estimate(draw: st.DrawFn, own: list[Record]) -> None:
    message = draw(one_of(own))
    try:
        tree = json.loads(message["data"])
        message["data"] = utf8(json_text(draw(changed_tree(tree))))
    except (ValueError, RecursionError):
        message["data"] = draw(changed_bytes(message["data"]))


def _result_with_state(seeds: Seeds, kind: str) -> dict[str, Content]:
    part, state = seeds.interrupted[kind]
    return {
        "hand.mcap": seeds.hand,
        "heads.mcap": seeds.heads,
        "out.mcap.part": part,
        "out.mcap.part.state": state,
    }


def states(seeds: Seeds) -> Strategy:
    """Checkpoints and unfinished results, with ``--resume``."""

    @composite
    def case(draw: st.DrawFn) -> Case:
        kind = draw(st.sampled_from(("mono", "mono", "stereo", "stereo", "hand")))
        files = _result_with_state(seeds, kind)
        name = draw(st.sampled_from(("out.mcap.part.state",) * 4 + ("out.mcap.part",)))
        data = files[name]
        assert isinstance(data, bytes)
        if name.endswith(".state"):
            files[name] = (
                resigned(draw(changed_npz(data))) if draw(st.integers(0, 3)) else draw(changed_npz(data))
            )
        else:
            files[name] = draw(changed_bytes(data))
        words = (*seeds.commands[kind], "-o", "out.mcap", "--resume")
        return Case(
            "states", words, {n: c for n, c in files.items() if n in words or n.startswith("out")}, OUT
        )

    return case()


def models(seeds: Seeds) -> Strategy:
    """What was learned, and models of faces."""
    tail = ("-o", "out.mcap", *HEAD)
    stereo = ("head", "stereo", "heads.mcap", *tail, "--load-model", "m.npz")
    mono = ("head", "mono", "heads.mcap", *tail, "--cameras", "left", "--passes", "1")
    return st.one_of(
        made_of(
            "models",
            "m.npz",
            changed_npz(seeds.models["stereo"]),
            st.just(stereo),
            **{"heads.mcap": seeds.heads},
        ),
        made_of(
            "models",
            "m.npz",
            changed_npz(seeds.models["mono"]),
            st.just((*mono, "--load-model", "m.npz")),
            **{"heads.mcap": seeds.heads},
        ),
        made_of(
            "models",
            "m.npz",
            changed_npz(seeds.face_model),
            st.just((*mono, "--face-model", "m.npz")),
            **{"heads.mcap": seeds.heads},
        ),
    )


# Texts


TOML_PIECES = (
    "x=" + "[" * 3000,
    "x=" + "[" * 300 + "]" * 300,
    "a." * 2000 + "b = 1",
    "x = {a={a={a=1}}}",
    "fx = true",
    "[cameras]",
    "[cameras.left]",
    '[cameras."\\u001b[2J"]',
    '[cameras."../x"]',
    "fx = 1e400",
    "fx = nan",
    "distortion = [1e300, 0, 0, 0]",
    "distortion = []",
    "crop = [0, 0, 4294967296, 1]",
    "crop = [-1, -1, 5, 5]",
    "depth_unit_mm = 1e308",
    "depth_unit_mm = -1",
    "missing = 99999999999999999999",
    "rotation = [[1]]",
    "translation_mm = [nan, 0, 0]",
    "fx = 1979-05-27T07:32:00Z",
    "width = 0",
)


def cameras(seeds: Seeds) -> Strategy:
    """camera.toml of one camera and of several."""
    single = of.depth_folder(seeds)
    several = of.grey_folder(seeds)
    toml = "rec/camera.toml"
    return st.one_of(
        made_of(
            "cameras",
            toml,
            changed_text(of.CAMERA_TOML, TOML_PIECES),
            of_recording("rec", heads=False),
            **_but(single, toml),
        ),
        made_of(
            "cameras",
            toml,
            changed_text(of.rig_toml(), TOML_PIECES),
            of_recording("rec", depth=False),
            **_but(several, toml),
        ),
        made_of(
            "cameras",
            "c.toml",
            changed_text(of.CAMERA_TOML, TOML_PIECES),
            st.sampled_from([("convert", "r.mcap", "-o", "out.mcap", "--camera", "c.toml")]),
            **{"r.mcap": seeds.hand},
        ),
    )


def _but(files: dict[str, Content], name: str) -> dict[str, Content]:
    return {key: content for key, content in files.items() if key != name}


def configurations(seeds: Seeds) -> Strategy:
    """Configurations, and poses to begin with."""
    from pathlib import Path

    texts_of = {
        kind: (Path(__file__).parents[2] / "configs" / f"{kind}.toml").read_text()
        for kind in ("hand", "head-stereo", "head-mono")
    }
    pose = (
        "position_mm = [0.0, 0.0, 800.0]\nquaternion_xyzw = [0.0, 0.0, 0.0, 1.0]\nangles_rad = "
        + str([0.0] * 15)
        + "\n"
    )
    tail = ("-o", "out.mcap")
    mono = (
        "head",
        "mono",
        "heads.mcap",
        *tail,
        *HEAD,
        "--cameras",
        "left",
        "--passes",
        "1",
        "--config",
        "c.toml",
    )
    stereo = ("head", "stereo", "heads.mcap", *tail, *HEAD, "--config", "c.toml")
    hand = ("hand", "run", "hand.mcap", *tail, *HAND, "--config", "c.toml")
    begin = ("hand", "run", "hand.mcap", *tail, *HAND[:6], "--end", "1", "--init", "c.toml")
    files = {"hand.mcap": seeds.hand, "heads.mcap": seeds.heads}
    choices = (
        (texts_of["head-mono"], mono),
        (texts_of["head-stereo"], stereo),
        (texts_of["hand"], hand),
        (pose, begin),
    )
    return st.one_of(
        *(
            made_of(
                "configurations",
                "c.toml",
                changed_text(text, TOML_PIECES),
                st.just(words),
                **{name: data for name, data in files.items() if name in words},
            )
            for text, words in choices
        )
    )


CSV_PIECES = (
    ",",
    ",,,",
    '"',
    '"a',
    "=1+1",
    "stamp_ns",
    "time_s",
    "filename,stamp_ns",
    "1e308",
    "9" * 400,
    "18446744073709551616",
    "-5",
    "0x10",
    "\x1b[2J",
    "../../etc/passwd",
    ",".join(["1"] * 5000),
)


PTS_PIECES = (*CSV_PIECES, "{", "}", "n_points: 68", "n_points: 4294967296", "nan 5", "5", "1 2 3", "1e400 1")


def tables(seeds: Seeds) -> Strategy:
    """timestamps.csv, truth, clicked points, keypoints, landmarks, gates and baselines."""
    folder, heads = of.depth_folder(seeds), of.grey_folder(seeds)
    stamps = "rec/timestamps.csv"
    tail = ("-o", "out.mcap", *HEAD)
    clicked = ("head", "stereo", "rec", *tail, "--init", "c.csv")
    mono = ("head", "mono", "rec", *tail, "--cameras", "left", "--passes", "1", "--init", "c.csv")
    result = {"r.mcap": seeds.results["hand"]}

    def told(file: str, tracker: str) -> tuple[str, ...]:
        own = ("--cameras", "left", "--passes", "1") if tracker == "mono" else ()
        return ("head", tracker, "rec", *tail, *own, "--landmarks", file)

    return st.one_of(
        made_of(
            "tables",
            stamps,
            changed_text(of.stamps_csv(), CSV_PIECES),
            of_recording("rec", heads=False),
            **_but(folder, stamps),
        ),
        made_of(
            "tables",
            stamps,
            changed_text(of.stamps_csv(), CSV_PIECES),
            of_recording("rec", depth=False),
            **_but(heads, stamps),
        ),
        made_of(
            "tables",
            "t.csv",
            changed_text(of.truth_csv(), CSV_PIECES),
            st.just(("convert", "rec", "-o", "out.mcap", "--truth", "t.csv")),
            **folder,
        ),
        made_of(
            "tables",
            "t.csv",
            changed_text(of.truth_csv(), CSV_PIECES),
            st.just(("eval", "r.mcap", "--truth", "t.csv")),
            **result,
        ),
        made_of(
            "tables",
            "a/000001.pts",
            changed_text(of.points_text(), PTS_PIECES),
            st.just(("eval", "r.mcap", "--truth", "a")),
            **{"r.mcap": seeds.results["mono"], "a/000002.pts": utf8(of.points_text())},
        ),
        st.builds(
            lambda digits, words: Case(
                "tables",
                words,
                {f"a/{digits}.pts": utf8(of.points_text()), "r.mcap": seeds.results["mono"]},
                OUT,
            ),
            NAME_DIGITS,
            st.just(("eval", "r.mcap", "--truth", "a")),
        ),
        made_of(
            "tables",
            "c.csv",
            changed_text(of.clicked_csv(), CSV_PIECES),
            st.sampled_from((clicked, mono)),
            **heads,
        ),
        made_of(
            "tables",
            "k.csv",
            changed_text(of.keypoints_csv(), CSV_PIECES),
            st.just(("hand", "run", "hand.mcap", *OUT_OF_HAND, "--keypoints", "k.csv")),
            **{"hand.mcap": seeds.hand},
        ),
        made_of(
            "tables",
            "k.json",
            changed_tree(of.keypoints_tree()).map(lambda t: utf8(json_text(t))),
            st.just(("hand", "run", "hand.mcap", *OUT_OF_HAND, "--keypoints", "k.json")),
            **{"hand.mcap": seeds.hand},
        ),
        made_of(
            "tables",
            "l.csv",
            changed_text(of.landmarks_csv(), CSV_PIECES),
            st.sampled_from((told("l.csv", "stereo"), told("l.csv", "mono"))),
            **heads,
        ),
        made_of(
            "tables",
            "l.json",
            changed_tree(of.landmarks_tree()).map(lambda t: utf8(json_text(t))),
            st.sampled_from((told("l.json", "stereo"), told("l.json", "mono"))),
            **heads,
        ),
        made_of(
            "tables",
            "g.txt",
            changed_text("coverage < 0.5\njoint_error_mm.mean > 1000\n", CSV_PIECES),
            st.just(("eval", "r.mcap", "--gates", "g.txt")),
            **result,
        ),
        made_of(
            "tables",
            "b.json",
            changed_tree({"metrics": {"coverage": 1.0}, "version": 1}).map(lambda t: utf8(json_text(t))),
            st.just(("eval", "r.mcap", "--baseline", "b.json")),
            **result,
        ),
    )


LIST_PIECES = (
    *CSV_PIECES,
    "0.5 depth/1305031102.160407.png",
    "1305031102160 depth/1305031102.193740.png",
    "1e99 depth/1305031102.193740.png",
    "1 depth/../depth/1305031102.193740.png 2 rgb/1305031102.193740.png",
    "# only a comment",
    "0 /etc/passwd",
    "9" * 20 + "." + "9" * 20 + " depth/1305031102.193740.png",
)
TIMES = "0.000000e+00\n3.3e-02\n6.7e-02\n"
NAME_DIGITS = st.one_of(
    st.integers(0, 10**12).map(str),
    st.integers(0, 120).map(lambda k: f"{k * 33_333:08d}"),
    st.integers(0, 9).map(lambda k: str(START_S + k)),
    st.integers(0, 99).map(lambda k: f"{START_S}.{k}"),
    st.integers(0, 99).map(lambda k: f"{START_S}_{10**7 * k}"),
    st.integers(0, 99).map(lambda k: str(10**3 * START_S + 33 * k)),
    st.sampled_from(
        ("9" * 240, "0" * 200, "1" * 19, "4" + "0" * 18, "1.2.3", "-5", "\u0663", "a", "1e9", "")
    ),
)


@composite
def _numbered(draw: st.DrawFn, files: dict[str, Content], folders: tuple[str, ...]) -> dict[str, Content]:
    """The images of folders under other names, of one layout or not."""
    changed = dict(files)
    for folder in folders:
        prefix, suffix = (
            draw(st.sampled_from(("", "d_", "0001-", "v1."))),
            draw(st.sampled_from(("", "_d", ".9"))),
        )
        own = [name for name in files if name.startswith(f"{folder}/") and name.endswith(".png")]
        called = draw(st.lists(NAME_DIGITS, min_size=len(own), max_size=len(own), unique=True))
        for name, digits in zip(own, called, strict=True):
            data = changed.pop(name)
            changed[f"{folder}/{prefix}{digits}{suffix}.png"] = data
    return changed


def image_folders(seeds: Seeds) -> Strategy:
    """Names of images, lists of TUM and EuRoC, and pages of TIFFs."""
    depth, heads = of.depth_folder(seeds), of.grey_folder(seeds)
    tum, euroc = of.listed_folder(seeds), of.camera_folders(seeds)
    stamps = "rec/timestamps.csv"
    single = {name: data for name, data in depth.items() if not name.endswith((".png", ".csv"))}
    rate = ("--fps", "30")
    of_depth = st.sampled_from(
        (("info", "rec"), ("convert", "rec", "-o", "out.mcap"), ("convert", "rec", "-o", "out.mcap", *rate))
    )
    of_heads = st.sampled_from((("info", "rec"), ("head", "stereo", "rec", "-o", "out.mcap", *HEAD, *rate)))

    def named(files: dict[str, Content], folders: tuple[str, ...], command: Any) -> Strategy:
        return st.builds(
            lambda changed, words: Case("image_folders", words, changed, OUT),
            _numbered(_but(files, stamps), folders),
            command,
        )

    def listed(name: str, text: str, files: dict[str, Content], command: Any) -> Strategy:
        return made_of("image_folders", name, changed_text(text, LIST_PIECES), command, **_but(files, name))

    associated = _but(_but(tum, "rec/depth.txt"), "rec/rgb.txt")
    pairs = "\n".join(f"{n} rgb/{n}.png {n} depth/{n}.png" for n in of.LISTED) + "\n"
    return st.one_of(
        named(depth, ("rec",), of_depth),
        named(heads, ("rec/left", "rec/right"), of_heads),
        listed("rec/times.txt", TIMES, _but(depth, stamps), of_depth),
        listed("rec/depth.txt", of.image_list("depth"), tum, of_depth),
        listed("rec/rgb.txt", of.image_list("rgb"), tum, of_heads),
        listed("rec/associations.txt", pairs, associated, of_depth),
        listed("rec/cam1/data.csv", of.camera_list(), euroc, of_heads),
        made_of("image_folders", "rec/a.tiff", changed_stack(seeds.depth), of_depth, **single),
        made_of(
            "image_folders",
            "rec/left/a.tiff",
            changed_stack(seeds.grey),
            of_heads,
            **{name: data for name, data in heads.items() if not name.startswith("rec/left")},
        ),
    )


MANIFEST = """gates = ["coverage < 0.5"]
[options]
seed = 3
[[recordings]]
path = "r.mcap"
name = "a"
truth = "r.mcap"
options = { hand-side = "left", smooth = true }
[[recordings]]
path = "*.mcap"
"""
MANIFEST_PIECES = (
    *CSV_PIECES,
    "[[recordings]]",
    'path = "/"',
    'path = "**/*"',
    'name = "../x"',
    "options = {}",
)
JOB_RECORD = {
    "key": "0" * 64,
    "page": "",
    "input": {"files": 1, "bytes": 5, "changed_ns": 1, "names": "", "sha256": "0" * 64},
    "output": [5, "0" * 64],
    "state": "done",
    "outcome": {"name": "r", "state": "done", "seconds": 1.5, "last_lines": ["x"], "pieces": []},
    "format": "posetrack.batch.job/1",
}


def batches(seeds: Seeds) -> Strategy:
    """Lists, manifests, and what is known of jobs; nothing is tracked."""

    def planned(source: str) -> Strategy:
        return st.just(("batch", "hand", "run", source, "-o", "out", "--dry-run"))

    recording = {"r.mcap": seeds.hand}
    return st.one_of(
        made_of("batches", "m.toml", changed_text(MANIFEST, MANIFEST_PIECES), planned("m.toml"), **recording),
        made_of(
            "batches", "l.txt", changed_text("r.mcap\n*.mcap\n", CSV_PIECES), planned("l.txt"), **recording
        ),
        made_of(
            "batches",
            "out/.batch/r.json",
            changed_tree(JOB_RECORD).map(lambda t: utf8(json_text(t))),
            planned("r.mcap"),
            **recording,
            **{"out/r.mcap": seeds.results["hand"]},
        ),
    )


# Pixels and meshes


def images(seeds: Seeds) -> Strategy:
    """PNG, TIFF, JPEG, PGM, BMP and WebP files in folders, and within MCAP messages."""
    depth, grey = of.depth_folder(seeds), of.grey_folder(seeds)
    one = seeds.depth[0]
    cases = []
    for suffix in (".png", ".tiff", ".pgm"):
        name = f"rec/000001{suffix}"
        files = {n: c for n, c in depth.items() if suffix == ".png" or not n.endswith(".png")}
        if suffix != ".png":
            files |= {
                f"rec/{k:06d}{suffix}": of.encoded(suffix, image) for k, image in enumerate(seeds.depth)
            }
            files["rec/timestamps.csv"] = of.stamps_csv().replace(".png", suffix).encode()
        cases.append(
            made_of(
                "images",
                name,
                changed_image(suffix, one),
                of_recording("rec", heads=False),
                **_but(files, name),
            )
        )
    for suffix in (".png", ".jpg", ".bmp", ".webp", ".tif"):
        name = f"rec/left/000001{suffix}"
        files = dict(grey)
        if suffix != ".png":
            files = {n: c for n, c in grey.items() if not n.startswith("rec/left")}
            files |= {
                f"rec/left/{k:06d}{suffix}": of.encoded(suffix, image) for k, image in enumerate(seeds.grey)
            }
        image = np.ascontiguousarray(seeds.grey[1])
        cases.append(
            made_of(
                "images",
                name,
                changed_image(suffix, image),
                of_recording("rec", depth=False),
                **_but(files, name),
            )
        )
    return st.one_of(*cases, _images_in_messages(seeds))


def _images_in_messages(seeds: Seeds) -> Strategy:
    from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage

    @composite
    def content(draw: st.DrawFn) -> bytes:
        of_depth = draw(st.booleans())
        records = read_records(seeds.hand if of_depth else seeds.heads)
        kinds = of.message_types(records)
        own = [m for m in messages(records) if kinds[m["channel_id"]] == "foxglove.CompressedImage"]
        message = draw(one_of(own))
        parsed = CompressedImage.FromString(message["data"])
        suffix = draw(st.sampled_from((".png", ".png", ".png", ".jpg", ".webp")))
        image = seeds.depth[0] if of_depth and suffix == ".png" else seeds.grey[0]
        parsed.data = draw(changed_image(suffix, image))
        message["data"] = parsed.SerializeToString()
        return file_bytes(records)

    return made_of("images", "r.mcap", content(), of_recording("r.mcap"))


JSON_PIECES = ("[1e12]", "[[]]", "[null]", '{"w": 1}', "1e400", "-1", "33554433")


def datasets(seeds: Seeds) -> Strategy:
    """Layouts of other tools: folders and archives with a file that was changed."""
    stray = {f"rec/{name}": content for name, content in layouts.stray_files(2, focal=(266.0, 270.0)).items()}
    stray["rec/camera_matrix.csv"] = b"1600, 0, 960\n0, 1600, 720\n0, 0, 1\n"
    biwi = {f"rec/{name}": content for name, content in layouts.biwi_files((3, 5)).items()}
    nyu = {f"rec/{name}": content for name, content in layouts.nyu_files((1,), 2).items()}
    own = layouts.r3d_files(2)
    record3d = {f"rec/{name}": content for name, content in own.items()}
    metadata = json.loads(own["metadata"])

    def text(name: str, files: dict[str, bytes], pieces: tuple[str, ...]) -> Strategy:
        content = changed_text(files[name].decode(), pieces)
        return made_of("datasets", name, content, of_recording("rec"), **_but(dict(files), name))

    def binary(name: str, files: dict[str, bytes]) -> Strategy:
        content = changed_bytes(files[name])
        return made_of("datasets", name, content, of_recording("rec"), **_but(dict(files), name))

    tree = changed_tree(metadata).map(lambda changed: utf8(json_text(changed)))
    whole = changed_bytes(layouts.r3d_bytes(own))
    members = tree.map(lambda changed: layouts.r3d_bytes(own | {"metadata": changed}))
    return st.one_of(
        text("rec/odometry.csv", stray, CSV_PIECES),
        text("rec/camera_matrix.csv", stray, CSV_PIECES),
        binary("rec/depth/000001.png", stray),
        binary("rec/confidence/000001.png", stray),
        text("rec/depth.cal", biwi, CSV_PIECES),
        text("rec/rgb.cal", biwi, CSV_PIECES),
        binary("rec/frame_00003_depth.bin", biwi),
        binary("rec/depth_1_0000001.png", nyu),
        made_of(
            "datasets", "rec/metadata", tree, of_recording("rec"), **_but(dict(record3d), "rec/metadata")
        ),
        text("rec/metadata", record3d, JSON_PIECES),
        binary("rec/rgbd/0.depth", record3d),
        binary("rec/rgbd/0.conf", record3d),
        made_of("datasets", "a.r3d", whole, of_recording("a.r3d")),
        made_of("datasets", "a.r3d", members, of_recording("a.r3d")),
    )


def videos(seeds: Seeds) -> Strategy:
    """Videos, those in messages, and what calls itself a video."""
    del seeds
    of_gif = commands((3, ("info", "v.gif")), (2, ("head", "mono", "v.gif", "-o", "out.mcap", *HEAD)))
    cases = [
        made_of("videos", "v.gif", changed_bytes(of.gif()), of_gif),
        made_of("videos", "r.mcap", _video_messages(), of_recording("r.mcap")),
    ]
    for suffix, code in ((".avi", "MJPG"), (".mp4", "mp4v"), (".mkv", "MJPG")):
        name = f"v{suffix}"
        words = commands(
            (3, ("info", name)), (2, ("head", "mono", name, "-o", "out.mcap", *HEAD, "--passes", "1"))
        )
        other: dict[str, Content] = {"other.avi": of.video(".avi", "MJPG")}
        cases.append(made_of("videos", name, changed_video(of.video(suffix, code)), words, **other))
    return st.one_of(*cases)


@composite
def _video_messages(draw: st.DrawFn) -> bytes:
    """Messages of one or two videos, with packets changed, lost, doubled and of other formats."""
    from foxglove_schemas_protobuf.CompressedVideo_pb2 import CompressedVideo

    formats = {"h264": "libx264", "h265": "libx265"}
    names = draw(st.lists(st.sampled_from(sorted(formats)), min_size=1, max_size=2, unique=True))
    records: list[Record] = [
        {"op": SCHEMA, "id": 1, "name": "foxglove.CompressedVideo", "encoding": "protobuf", "data": b""}
    ]
    for number, name in enumerate(names, 1):
        packets = of.video_packets(formats[name])
        channel = {"op": CHANNEL, "id": number, "schema_id": 1, "topic": f"/{name}/video"}
        records.append({**channel, "message_encoding": "protobuf", "metadata": {}})
        order = draw(st.one_of(st.just([0, 1, 2]), st.lists(st.integers(0, 2), max_size=6)))
        for place, k in enumerate(order):
            stamp = of.START_NS + place * of.PERIOD_NS
            own = CompressedVideo(frame_id=name, format=name, data=packets[k])
            own.timestamp.FromNanoseconds(stamp)
            how = draw(st.sampled_from(("as is", "as is", "as is", "data", "data", "format", "message")))
            if how == "data":
                own.data = draw(changed_bytes(own.data))
            elif how == "format":
                own.format = draw(st.sampled_from(("h264", "h265", "vp9", "av1", "", "x", "\x1b[2J")))
            whole = own.SerializeToString()
            content = draw(ros.changed_protobuf(own)) if how == "message" else whole
            message = {"op": MESSAGE, "channel_id": number, "sequence": place, "log_time": stamp}
            records.append({**message, "publish_time": stamp, "data": content})
    return file_bytes([{"op": 1}, {"op": CHUNK, "inner": records}])


def bags(seeds: Seeds) -> Strategy:
    """Bags of ROS 1, databases and folders of ROS 2, a Kinect's file: their bytes changed, joined and cut."""
    del seeds
    cases = []
    for kind, name in {
        "none": "r.bag",
        "bz2": "r.bag",
        "lz4": "r.bag",
        "db3": "r.db3",
        "mkv": "r.mkv",
    }.items():
        data = of.bag(kind)
        cases.append(made_of("bags", name, changed_bytes(data), of_recording(name)))
    folder: dict[str, Content] = {"r/metadata.yaml": b"relative_file_paths:\n  - r_0.db3\n  - r_1.db3\n"}
    cases.append(made_of("bags", "r/r_0.db3", changed_bytes(of.bag("db3")), of_recording("r"), **folder))
    return st.one_of(*cases)


def bag(seeds: Seeds) -> Strategy:
    """Records of bags of ROS 1."""
    del seeds
    return made_of("bag", "r.bag", changed_bag(), of_recording("r.bag"))


def db3(seeds: Seeds) -> Strategy:
    """Tables and rows of databases of ROS 2."""
    del seeds
    return made_of("db3", "r.db3", changed_database(), of_recording("r.db3"))


def metadata(seeds: Seeds) -> Strategy:
    """metadata.yaml of folders of ROS 2."""
    own: dict[str, Content] = {"r/r_0.db3": of.bag("db3")}
    mcap: dict[str, Content] = {"r/r_0.mcap": seeds.hand}
    return st.one_of(
        *(
            made_of("metadata", "r/metadata.yaml", changed_metadata(), of_recording("r"), **parts)
            for parts in (own, mcap)
        )
    )


def mkv(seeds: Seeds) -> Strategy:
    """Elements of an Azure Kinect's Matroska."""
    del seeds
    return made_of("mkv", "r.mkv", changed_matroska(), of_recording("r.mkv"))


def detectors(seeds: Seeds) -> Strategy:
    """Models of the face detector, as ONNX."""
    kps = [-1.0, 0.0, 1.0, 0.0, 0.0, 0.5, -0.8, 2.0, 0.8, 2.0]
    content = changed_bytes(yunet_like({"cls": [1.0], "obj": [1.0], "bbox": [0.0] * 4, "kps": kps}))
    detector = ("--detector", "yunet", "--detector-model", "m.onnx")
    words = ("head", "mono", "heads.mcap", "-o", "out.mcap", *HEAD, "--cameras", "left", "--passes", "1")
    return made_of(
        "detectors", "m.onnx", content, st.just((*words, *detector)), **{"heads.mcap": seeds.heads}
    )


def meshes(seeds: Seeds) -> Strategy:
    """Skinned hands as GLB."""
    words = ("hand", "run", "hand.mcap", "-o", "out.mcap", *HAND[:-1], "1", "--hand-mesh", "m.glb")
    return made_of("meshes", "m.glb", changed_glb(), st.just(words), **{"hand.mcap": seeds.hand})


# Names


def names(seeds: Seeds) -> Strategy:
    """Names of files and cameras, links and pipes in the place of files."""
    odd = texts().filter(
        lambda t: 0 < len(utf8(t)) < 200 and "\0" not in t and "/" not in t and t not in ("..", ".")
    )
    safe = odd.map(lambda t: utf8(t).decode("utf-8", "surrogateescape")).map(lambda t: "./" + t)

    @composite
    def case(draw: st.DrawFn) -> Case:
        how = draw(st.sampled_from(("name", "camera", "special", "link", "output", "frames")))
        name = draw(safe)
        result = seeds.results["hand"]
        words: tuple[str, ...]
        if how == "name":
            content = draw(one_of((seeds.hand, result, b"", b"x", of.CAMERA_TOML.encode())))
            words = draw(st.one_of(of_recording(name), of_result(name)))
            return Case("names", words, {name: content}, (*OUT, "out.html", "out.npz"))
        if how == "camera":
            plain = name.removeprefix("./")
            files: dict[str, Content] = {
                f"rec/{plain}/0.png": of.png(seeds.grey[0]),
                "rec/b/0.png": of.png(seeds.grey[0]),
            }
            return Case("names", draw(of_recording("rec", depth=False)), files, OUT)
        if how == "frames":
            plain = name.removeprefix("./")
            frames: dict[str, Content] = {
                f"rec/{plain}.png": of.png(seeds.depth[0]),
                "rec/camera.toml": of.CAMERA_TOML.encode(),
            }
            return Case("names", draw(of_recording("rec", heads=False)), frames, OUT)
        if how == "output":
            words = ("convert", "r.mcap", "-o", "out.mcap", *draw(st.sampled_from(((), ("--overwrite",)))))
            place = draw(
                st.sampled_from(
                    ("out.mcap", "out.mcap.part", "out.mcap.part.state", "out.mcap.part.state.tmp")
                )
            )
            special = draw(
                st.sampled_from((Link("r.mcap"), Link("other"), Link("/dev/null"), Pipe(), b"", b"x"))
            )
            return Case("names", words, {"r.mcap": seeds.hand, place: special, "other": b"1"}, OUT)
        special = draw(
            st.sampled_from((Link("/dev/zero"), Link("nowhere"), Link("x"), Link("."), Link("/dev/full")))
        )
        if how == "special":
            special = Pipe()
        place = draw(st.sampled_from(("x", "rec/camera.toml", "rec/timestamps.csv", "rec/000001.png", "rec")))
        folder = of.depth_folder(seeds)
        files = {n: c for n, c in folder.items() if not n.startswith(place)} | {place: special}
        if place == "x":
            words = draw(
                st.one_of(of_recording("x"), of_result("x"), st.sampled_from(_options_of_files("x")))
            )
            if "r.mcap" in words:
                files["r.mcap"] = result
        else:
            words = draw(of_recording("rec", heads=False))
        return Case("names", words, files, (*OUT, "out.html", "out.npz"))

    return case()


def _options_of_files(name: str) -> list[tuple[str, ...]]:
    return [
        ("convert", "rec", "-o", "out.mcap", "--camera", name),
        ("convert", "rec", "-o", "out.mcap", "--truth", name),
        ("eval", "r.mcap", "--truth", name),
        ("eval", "r.mcap", "--gates", name),
        ("eval", "r.mcap", "--baseline", name),
        ("eval", "r.mcap", "--recording", name),
        ("hand", "run", "rec", "-o", "out.mcap", "--config", name),
        ("hand", "run", "rec", "-o", "out.mcap", "--hand-mesh", name),
        ("hand", "run", "rec", "-o", "out.mcap", "--init", name),
        ("head", "mono", "rec", "-o", "out.mcap", "--face-model", name),
        ("head", "mono", "rec", "-o", "out.mcap", "--load-model", name),
        ("head", "mono", "rec", "-o", "out.mcap", "--init", name),
        ("head", "mono", "rec", "-o", "out.mcap", "--detector", "yunet", "--detector-model", name),
        ("view", name, "-o", "v"),
    ]


TARGETS: dict[str, Callable[[Seeds], Strategy]] = {
    "mcap": mcap,
    "ros1": ros1,
    "ros2": ros2,
    "protobuf": protobuf,
    "results": results,
    "states": states,
    "models": models,
    "cameras": cameras,
    "configurations": configurations,
    "tables": tables,
    "batches": batches,
    "images": images,
    "image_folders": image_folders,
    "datasets": datasets,
    "videos": videos,
    "bags": bags,
    "bag": bag,
    "db3": db3,
    "metadata": metadata,
    "mkv": mkv,
    "detectors": detectors,
    "meshes": meshes,
    "names": names,
}
