"""Write a synthetic recording with its truth to an MCAP file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage

from posetrack_cli import __version__
from posetrack_cli.hand.model import MESH_DIGEST
from posetrack_cli.mcap.sink import McapSink
from posetrack_cli.outputs import check_output, whole_or_nothing
from posetrack_cli.recording.conversion import CALIBRATION_TOPIC, CHUNK_BYTES, IMAGE_TOPIC
from posetrack_cli.recording.identity import file_digest
from posetrack_cli.recording.image_files import encode_png
from posetrack_cli.recording.mcap_calibration import calibration_message
from posetrack_cli.synthesis.hand.frames import Plan, SyntheticFrame, make_plan, render_plan
from posetrack_cli.synthesis.hand.options import SWITCH_NAMES, SynthOptions
from posetrack_cli.synthesis.hand.sensor import CAMERA
from posetrack_cli.synthesis.hand.truth import TruthChannels
from posetrack_cli.synthesis.hand.walk import WalkNoise

SYNTH_RECORD = "posetrack.synth"
PNG_LEVEL = 1
"""Noise does not compress: level 9 takes ten times as long for some per cent."""

Report = Callable[[SyntheticFrame], None]


@dataclass(frozen=True)
class Synthesis:
    """What was written.

    Attributes:
        frames: number of frames written.
        dropped: number of frames left out as dropped.
        seconds: from the first to the last frame's stamp.
    """

    frames: int
    dropped: int
    seconds: float


def write_synthetic(
    options: SynthOptions,
    out: Path,
    *,
    overwrite: bool = False,
    noise: WalkNoise | None = None,
    report: Report = lambda frame: None,
) -> Synthesis:
    """Write a synthetic recording; the same options give the same bytes on the same machine.

    The depth is 16-bit PNG (foxglove.CompressedImage) on ``/camera/depth/image``, the truth lies on
    ``/truth/hand/...``, the options are in the metadata ``posetrack.synth``. The file is written as
    ``out`` + ``.part`` and renamed when it is complete.

    Args:
        options: of the recording.
        out: the file, named ``*.mcap``.
        overwrite: whether ``out`` may be replaced.
        noise: of the random walks A and B.
        report: called with every frame that is written.

    Raises:
        UsageError: ``out`` exists and may not be replaced, or is not named as an MCAP file.
        ResultError: the file cannot be written.
        RenderingError: there is no working GL.
    """
    check_output(out, overwrite=overwrite)
    noise = noise or WalkNoise()
    plan = make_plan(options, noise)
    with (
        whole_or_nothing(out) as part,
        McapSink(part, compression="none", chunk_bytes=CHUNK_BYTES) as sink,
    ):
        sink.metadata(SYNTH_RECORD, synth_record(options, plan, noise))
        written = _write(sink, options, plan, report)
        sink.finish()
    return written


def synth_record(options: SynthOptions, plan: Plan, noise: WalkNoise) -> dict[str, str]:
    """Return the metadata that tells how a recording was made."""
    record = {
        "version": __version__,
        "frames_written": str(int(plan.written.sum())),
        "velocity": "none" if plan.motion.twists is None else "exact",
        **{f.name: str(getattr(options, f.name)) for f in fields(options) if f.name != "switches"},
        **{f"switch.{name}": str(getattr(options.switches, name)).lower() for name in SWITCH_NAMES},
        "anatomy.segments_mm": _numbers(plan.anatomy.segments),
        **({} if options.mesh is None else {MESH_DIGEST: file_digest(Path(options.mesh))[1]}),
        "anatomy.base_positions_mm": _numbers(plan.anatomy.base_positions),
    }
    if options.motion == "A":
        record["noise.pose_sd"] = _numbers(options.speed * noise.walk.vector())
    if options.motion == "B":
        record["noise.pose_sd"] = _numbers(options.speed * noise.pose.vector())
        record["noise.velocity_sd"] = _numbers(options.speed * noise.velocity.vector())
    return dict(sorted(record.items()))


def _write(sink: McapSink, options: SynthOptions, plan: Plan, report: Report) -> Synthesis:
    stamps = plan.timeline.stamps_ns[plan.written]
    calibration = calibration_message(CAMERA, int(stamps[0]), CAMERA.name)
    calibrations = sink.channel(CALIBRATION_TOPIC, type(calibration))
    images = sink.channel(IMAGE_TOPIC, CompressedImage)
    truth = TruthChannels(sink)
    sink.write(calibrations, int(stamps[0]), calibration.SerializeToString(deterministic=True))
    for frame in render_plan(plan, options):
        sink.write(images, frame.stamp_ns, _image_bytes(frame))
        truth.write(frame)
        report(frame)
    dropped = int(plan.timeline.dropped.sum())
    return Synthesis(len(stamps), dropped, float(stamps[-1] - stamps[0]) * 1e-9)


def _image_bytes(frame: SyntheticFrame) -> bytes:
    message = CompressedImage(frame_id=CAMERA.name, format="png", data=encode_png(frame.depth, PNG_LEVEL))
    message.timestamp.FromNanoseconds(frame.stamp_ns)
    return bytes(message.SerializeToString(deterministic=True))


def _numbers(values: Any) -> str:
    return " ".join(f"{value:.6g}" for value in np.ravel(values))
