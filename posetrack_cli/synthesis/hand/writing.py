"""Write a synthetic recording of a hand with its truth to an MCAP file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage

from posetrack_cli.hand.model import MESH_DIGEST
from posetrack_cli.mcap.sink import McapSink, serialised
from posetrack_cli.outputs import check_output
from posetrack_cli.recording.conversion import CALIBRATION_TOPIC, IMAGE_TOPIC
from posetrack_cli.recording.identity import file_digest
from posetrack_cli.recording.image_files import encode_png
from posetrack_cli.recording.message_calibration import calibration_message
from posetrack_cli.synthesis.hand.frames import SUBJECT, Plan, SyntheticHandFrame, make_plan, render_plan
from posetrack_cli.synthesis.hand.options import SynthOptions
from posetrack_cli.synthesis.hand.sensor import CAMERA
from posetrack_cli.synthesis.hand.walk import WalkNoise
from posetrack_cli.synthesis.recording import (
    Synthesis,
    TruthChannels,
    numbers_text,
    recording_file,
    reported,
    synth_record,
    write_all,
)

PNG_LEVEL = 1
"""Noise does not compress: level 9 takes ten times as long for some per cent."""

Report = Callable[[SyntheticHandFrame], None]


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
    stamps = plan.timeline.stamps_ns[plan.written]
    record = synth_record(options, _facts(plan, noise))
    frames = reported(render_plan(plan), report)
    with recording_file(out) as sink:
        write_all(sink, record, frames, lambda sink: _Channels(sink, int(stamps[0])))
    return Synthesis(len(stamps), int(plan.timeline.dropped.sum()), float(stamps[-1] - stamps[0]) * 1e-9)


def _facts(plan: Plan, noise: WalkNoise) -> dict[str, str]:
    """What the metadata tells beside the options."""
    options = plan.options
    facts = {
        "frames_written": str(int(plan.written.sum())),
        "velocity": "none" if plan.motion.twists is None else "exact",
        **{f"switch.{name}": str(value).lower() for name, value in asdict(options.switches).items()},
        "anatomy.segments_mm": numbers_text(plan.anatomy.segments),
        "anatomy.base_positions_mm": numbers_text(plan.anatomy.base_positions),
    }
    if options.mesh is not None:
        facts[MESH_DIGEST] = file_digest(Path(options.mesh))[1]
    if options.motion == "A":
        facts["noise.pose_sd"] = numbers_text(options.speed * noise.walk.vector())
    if options.motion == "B":
        facts["noise.pose_sd"] = numbers_text(options.speed * noise.pose.vector())
        facts["noise.velocity_sd"] = numbers_text(options.speed * noise.velocity.vector())
    return facts


class _Channels:
    """Puts a recording's calibration, images and truth on their topics."""

    def __init__(self, sink: McapSink, first_ns: int) -> None:
        self._sink = sink
        calibration = calibration_message(CAMERA, first_ns, CAMERA.name)
        calibrations = sink.channel(CALIBRATION_TOPIC, type(calibration))
        self._images = sink.channel(IMAGE_TOPIC, CompressedImage)
        self._truth = TruthChannels(sink, SUBJECT, "joint_states")
        sink.write(calibrations, first_ns, serialised(calibration))

    def write(self, frame: SyntheticHandFrame) -> None:
        """Write one frame and the truth about it."""
        image = encode_png(frame.depth, PNG_LEVEL)
        message = CompressedImage(frame_id=CAMERA.name, format="png", data=image)
        message.timestamp.FromNanoseconds(frame.stamp_ns)
        self._sink.write(self._images, frame.stamp_ns, serialised(message))
        self._truth.write(frame)
