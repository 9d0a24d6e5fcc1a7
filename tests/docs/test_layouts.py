"""The layouts for Foxglove name topics and fields that results have."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

from posetrack_cli.evaluation.measuring.catalogue import catalogue, is_measured
from posetrack_cli.evaluation.measuring.subjects import KINDS
from posetrack_cli.recording.conversion import IMAGE_TOPIC
from posetrack_cli.results import ResultWriter, read_result
from posetrack_cli.results.topics import TRACKS, topics_prefix
from support.markdown import ROOT
from support.results import CAMERA, RUN, SUBJECT, make_estimate

LAYOUTS = {"hand": ROOT / "docs" / "foxglove-hand.json", "head": ROOT / "docs" / "foxglove-head.json"}


def described(path: Path) -> dict[str, set[str]]:
    """Of each topic the paths of its fields, such as ``pose.position.x``."""
    found = {}
    for schema, channel in read_result(path).channels:
        if schema.encoding == "jsonschema":
            found[channel.topic] = set(json.loads(schema.data)["properties"])
        else:
            name = schema.name.removeprefix("foxglove.")
            module = import_module(f"foxglove_schemas_protobuf.{name}_pb2")
            found[channel.topic] = set(fields(getattr(module, name).DESCRIPTOR))
    return found


def fields(descriptor: Any, prefix: str = "", depth: int = 3) -> Any:
    for field in descriptor.fields:
        yield f"{prefix}{field.name}"
        if field.message_type is not None and depth:
            yield from fields(field.message_type, f"{prefix}{field.name}.", depth - 1)


@pytest.fixture(scope="module", params=LAYOUTS)
def case(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Any, dict[str, set[str]]]:
    """A layout, and the topics of a result of its subject, which has a smoothed track."""
    subject = replace(SUBJECT, name=request.param)
    if subject.name == "head":
        subject = replace(subject, lines=((0, 1),), triangles=None)
    path = tmp_path_factory.mktemp("layout") / "r.mcap"
    with ResultWriter(path, subject, CAMERA, RUN) as writer:
        writer.write(make_estimate(0))
        writer.write_smoothed(make_estimate(0))
        writer.finish({})
    topics = described(path)
    for track in TRACKS:  # of ``eval --mcap``
        topics[f"/eval{topics_prefix(subject.name, track)}"] = metrics_of(subject.name)
    return json.loads(LAYOUTS[request.param].read_text(encoding="utf-8")), topics


def metrics_of(subject: str) -> set[str]:
    """The metrics that a frame of a subject may have."""
    known = catalogue().values()
    return {metric.name for metric in known if is_measured(metric, KINDS[subject]) and not metric.scalar}


def panels(node: Any) -> list[str]:
    """The panels of a mosaic, from first to second."""
    if isinstance(node, str):
        return [node]
    assert set(node) == {"direction", "first", "second", "splitPercentage"}
    assert node["direction"] in ("row", "column") and 0 < node["splitPercentage"] < 100
    return [*panels(node["first"]), *panels(node["second"])]


def test_every_panel_is_placed_once(case: tuple[Any, Any]) -> None:
    layout, _ = case
    assert set(layout) == {"configById", "globalVariables", "userNodes", "playbackConfig", "layout"}
    assert sorted(panels(layout["layout"])) == sorted(layout["configById"])
    kinds = {name.split("!")[0] for name in layout["configById"]}
    assert kinds == {"3D", "Image", "StateTransitions", "Plot", "RawMessages"}


def test_topics_and_fields_exist(case: tuple[Any, dict[str, set[str]]]) -> None:
    layout, topics = case
    images = {IMAGE_TOPIC, "/camera/image"}  # of recordings that convert, and head synth, make
    text = json.dumps(layout)
    paths = set(re.findall(r'"(/[\w/]+(?:\.[\w.]+)?)"', text))
    assert len(paths) > 6
    for path in paths - images:
        topic, _, field = path.partition(".")
        assert topic in topics, f"no topic {topic}"
        assert not field or field in topics[topic], f"{topic} has no {field}"
