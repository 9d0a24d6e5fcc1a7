"""Write a synthetic recording of a head with its truth: an MCAP file, or a folder of images."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from posetrack_cli import __version__
from posetrack_cli.errors import UsageError
from posetrack_cli.mcap.sink import McapSink
from posetrack_cli.outputs import check_output, whole_or_nothing
from posetrack_cli.recording.conversion import CHUNK_BYTES
from posetrack_cli.recording.mcap_calibration import calibration_message
from posetrack_cli.results import messages
from posetrack_cli.synthesis.head.encoding import FORMATS, image_message, message_class
from posetrack_cli.synthesis.head.expression_script import deforming_interval
from posetrack_cli.synthesis.head.folder_writing import SYNTH_RECORD, check_folder_output, write_folder
from posetrack_cli.synthesis.head.frames import Plan, SyntheticHeadFrame, make_plan, render_plan
from posetrack_cli.synthesis.head.options import HeadSynthOptions
from posetrack_cli.synthesis.head.truth import TruthChannels

TRANSFORMS_TOPIC = "/tf"

Report = Callable[[SyntheticHeadFrame], None]


@dataclass(frozen=True)
class Synthesis:
    """What was written: frames, images that are missing of them, seconds from the first to the last stamp."""

    frames: int
    missing: int
    seconds: float


def write_synthetic(
    options: HeadSynthOptions,
    out: Path,
    *,
    image_format: str = "jpeg",
    overwrite: bool = False,
    report: Report = lambda frame: None,
) -> Synthesis:
    """Write a synthetic recording; the same options give the same bytes on the same machine.

    A name that ends in ``.mcap`` is a file: images of camera NAME on ``/NAME/image``
    (foxglove.CompressedImage or RawImage), intrinsics on ``/NAME/calibration``, where the second camera
    stands on ``/tf``, truth on ``/truth/head/...``, the options in the metadata ``posetrack.synth``.
    Another name is a folder with a folder of images for each camera, ``camera.toml``, ``timestamps.csv``
    and ``truth.mcap``.

    Args:
        options: of the recording.
        out: file or folder.
        image_format: ``jpeg``, ``png`` or, in a file, ``raw``.
        overwrite: whether ``out`` may be replaced.
        report: called with every frame that is written.

    Raises:
        UsageError: ``out`` exists and may not be replaced, or the format cannot be used.
        ResultError: it cannot be written.
        RenderingError: there is no working GL.
    """
    is_file = out.suffix == ".mcap"
    _check_format(image_format, is_file)
    check = check_output if is_file else check_folder_output
    check(out, overwrite=overwrite)
    plan = make_plan(options)
    frames = (_reported(frame, report) for frame in render_plan(plan, options))
    record = synth_record(options, plan)
    if is_file:
        with (
            whole_or_nothing(out) as part,
            McapSink(part, compression="none", chunk_bytes=CHUNK_BYTES) as sink,
        ):
            sink.metadata(SYNTH_RECORD, record)
            channels = RecordingChannels(sink, plan, image_format)
            for frame in frames:
                channels.write(frame)
            sink.finish()
    else:
        write_folder(out, plan, frames, image_format, record)
    return Synthesis(options.frames, int(plan.dropped.sum()), options.duration_s)


def synth_record(options: HeadSynthOptions, plan: Plan) -> dict[str, str]:
    """Return the metadata that tells how a recording was made, and when what happens in it."""
    deforming = deforming_interval(options)
    turn = plan.movement.turn_interval
    record = {
        "version": __version__,
        **{f.name: str(getattr(options, f.name)) for f in fields(options)},
        "neutral_shape_mm": _numbers(plan.person.points),
        "deforming_s": "" if deforming is None else _numbers(deforming),
        "turn_s": "" if turn is None else _numbers(turn),
        "occlusion_s": "" if plan.passing is None else _numbers(plan.passing.interval),
        **{f"looks.{f.name}": str(getattr(plan.identity.looks, f.name)) for f in fields(plan.identity.looks)},
    }
    return dict(sorted(record.items()))


class RecordingChannels:
    """Puts a recording's images, calibration and truth on their topics."""

    def __init__(self, sink: McapSink, plan: Plan, image_format: str) -> None:
        self._sink, self._plan, self._format = sink, plan, image_format
        self._calibrate(int(plan.stamps_ns[0]))
        image = message_class(image_format)
        self._images = [sink.channel(f"/{camera.name}/image", image) for camera in plan.cameras]
        self._truth = TruthChannels(sink, plan.cameras[0].name)

    def write(self, frame: SyntheticHeadFrame) -> None:
        """Write one frame and the truth about it."""
        for channel, camera, image in zip(self._images, self._plan.cameras, frame.images, strict=True):
            if image is not None:
                data = image_message(image, self._format, camera.name, frame.stamp_ns)
                self._sink.write(channel, frame.stamp_ns, data)
        self._truth.write(frame)

    def _calibrate(self, stamp_ns: int) -> None:
        for camera in self._plan.cameras:
            message = calibration_message(camera, stamp_ns, camera.name)
            channel = self._sink.channel(f"/{camera.name}/calibration", type(message))
            self._sink.write(channel, stamp_ns, message.SerializeToString(deterministic=True))
        if len(self._plan.cameras) > 1:
            transforms = messages.camera_transforms(self._plan.cameras, self._plan.cameras[0].name, stamp_ns)
            channel = self._sink.channel(TRANSFORMS_TOPIC, type(transforms))
            self._sink.write(channel, stamp_ns, transforms.SerializeToString(deterministic=True))


def _check_format(image_format: str, is_file: bool) -> None:
    known = FORMATS if is_file else FORMATS[:2]
    if image_format not in known:
        raise UsageError("--image-format cannot be used", found=image_format, expected=" or ".join(known))


def _reported(frame: SyntheticHeadFrame, report: Report) -> SyntheticHeadFrame:
    report(frame)
    return frame


def _numbers(values: Any) -> str:
    return " ".join(f"{value:.6g}" for value in np.ravel(values))
