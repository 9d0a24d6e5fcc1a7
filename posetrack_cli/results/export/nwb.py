"""Export of a track as NWB (Neurodata Without Borders) with the extension ndx-pose.

``processing/behavior/PoseEstimation`` has one 3-D series per point in axes of the reference camera, stored in
mm with the conversion to metres. The points in the images of each camera follow in modules named
``SLEAP_VIDEO_...``, the only ones that sleap-io reads. Lost frames are NaN. Identifiers derive from the
result, and dates from the session, so that equal results give equal bytes.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from uuid import NAMESPACE_OID, UUID, uuid5

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.errors import ResultError, UsageError
from posetrack_cli.files import open_output
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.recording.identity import file_digest
from posetrack_cli.results.columns import Columns
from posetrack_cli.results.derived import is_tracked, pixels
from posetrack_cli.results.estimate import Subject
from posetrack_cli.results.export.source import CAMERA_AXES, ExportSource, session_time
from posetrack_cli.results.fields import BY_NAME
from posetrack_cli.text import printable
from posetrack_cli.units import METRES_PER_MM

FIELDS = ("stamp_ns", "status", "confidence", "points")


def write_nwb(source: ExportSource, path: Path) -> None:
    """Write a track.

    Raises:
        UsageError: pynwb or ndx-pose is not installed, or the session's start is unknown.
        ResultError: the result has no estimates or cannot be read, or NWB cannot represent a name.
    """
    os.environ.setdefault("PYNWB_NO_CACHE_DIR", "1")  # its cache is a pickle in the user's home
    try:
        import ndx_pose
        import pynwb  # optional dependencies, extra "nwb"
    except ImportError as error:
        raise UsageError("nwb needs pynwb and ndx-pose", hint="pip install 'posetrack[nwb]'") from error
    columns = source.columns(FIELDS)
    if not len(columns["stamp_ns"]):
        raise ResultError("has no estimates", where=source.where)
    with TemporaryDirectory() as folder, open_output(path) as stream:
        named = Path(folder) / "track.nwb"  # pynwb requires the suffix, which NAME.part lacks
        try:
            with warnings.catch_warnings(), pynwb.NWBHDF5IO(named, "w") as file:
                # sleap-io needs original_videos, which ndx-pose has deprecated
                warnings.simplefilter("ignore", DeprecationWarning)
                file.write(_Session(source, columns, pynwb, ndx_pose).file())
        except (ValueError, TypeError) as error:
            raise ResultError("cannot be written as NWB", where=source.where, found=error) from error
        stream.write(named.read_bytes())


class _Session:
    """NWB objects of a track."""

    def __init__(self, source: ExportSource, columns: Columns, pynwb: Any, ndx_pose: Any) -> None:
        self._source, self._columns, self._nwb, self._pose = source, columns, pynwb, ndx_pose
        self._subject: Subject = source.result.subject
        content = (
            f"{file_digest(source.result.path)[1]} {source.topic} {source.lost} {source.session_start_ns}"
        )
        self._id: UUID = uuid5(NAMESPACE_OID, content)

    def file(self) -> Any:
        """Return the file.

        Raises:
            UsageError: the stamps are not UNIX time, and no start of the session is given.
        """
        start, seconds = session_time(self._source, self._columns["stamp_ns"])
        if start is None:
            what, found = "start of the session is unknown", "stamps that are not UNIX time"
            hint = "pass --session-start"
            raise UsageError(what, where=self._source.result.path, found=found, hint=hint)
        result, subject = self._source.result, self._subject
        file = self._made(
            self._nwb.NWBFile,
            session_description=printable(f"{subject.name} tracked in {result.run.get('input.name', '')}"),
            identifier=str(self._id),
            session_start_time=start,
            file_create_date=[start],
        )
        edges = subject.lines or [(p, k) for k, p in enumerate(subject.point_parents) if p >= 0]
        nodes = [_label(name) for name in subject.point_names]
        pairs = np.array(edges, dtype=np.uint8).reshape(-1, 2)
        skeleton = self._made(self._pose.Skeleton, name=_label(subject.name), nodes=nodes, edges=pairs)
        skeletons = self._made(self._pose.Skeletons, skeletons=[skeleton])
        devices = [self._device(camera) for camera in result.image_cameras]
        for device in devices:
            file.add_device(device)
        space = self._estimation("PoseEstimation", self._in_space(seconds), skeleton, devices[:1])
        self._add(file, "behavior", "poses estimated by posetrack", skeletons, space)
        for k, (camera, device) in enumerate(zip(result.image_cameras, devices, strict=True)):
            video = [printable(result.run.get("input.name", "")) + (f"/{device.name}" if devices[1:] else "")]
            image = self._estimation(
                "track0", self._in_image(camera, seconds), skeleton, [device], original_videos=video
            )
            name = f"SLEAP_VIDEO_{k:03}_{device.name}"
            self._add(file, name, f"points in the images of camera {device.name}", image)
        return file

    def _made(self, kind: Any, key: str = "", **fields: Any) -> Any:
        """Return an NWB object whose id derives from its kind and name, as by default it is random."""
        name = f"{kind.__name__} {fields.get('name', '')} {key}"
        made = kind.__new__(kind, object_id=str(uuid5(self._id, name)))
        kind.__init__(made, **fields)
        return made

    def _add(self, file: Any, name: str, description: str, *content: Any) -> None:
        module = self._made(self._nwb.ProcessingModule, name=name, description=description)
        file.add_processing_module(module)
        for one in content:
            module.add(one)

    def _device(self, camera: Camera) -> Any:
        transform = np.array(camera.camera_T_reference)
        model = f", {camera.distortion_model} distortion" if camera.is_distorted else ""
        return self._made(
            self._pose.CalibratedCamera,
            name=_label(camera.name),
            description=f"images of {camera.width} x {camera.height} pixels{model}; translation in metres",
            intrinsic_matrix=camera.matrix,
            rotation_matrix=transform[:, :3],
            translation_vector=METRES_PER_MM * transform[:, 3],
            distortion_coefficients=np.array(camera.distortion) if camera.distortion else None,
        )

    def _estimation(
        self, name: str, series: Iterable[Any], skeleton: Any, devices: list[Any], **more: Any
    ) -> Any:
        run, about = self._source.result.run, f"topic {self._source.topic}"
        return self._made(
            self._pose.PoseEstimation,
            key=devices[0].name if devices else "",
            name=name,
            pose_estimation_series=list(series),
            description=f"points of a {_label(self._subject.name)}, {about}; NaN where lost",
            device=devices[0] if devices else None,
            scorer=printable(run.get("tracker", "posetrack")),
            source_software="posetrack",
            source_software_version=printable(run.get("version", "")),
            skeleton=skeleton,
            **more,
        )

    def _in_space(self, seconds: FloatArray) -> Iterator[Any]:
        points = np.where(is_tracked(self._columns)[:, None, None], self._columns["points"], np.nan)
        frame = f"origin at the centre of camera {self._subject.camera_frame}; {CAMERA_AXES}"
        return self._series(points, frame, seconds, unit="meters", conversion=METRES_PER_MM)

    def _in_image(self, camera: Camera, seconds: FloatArray) -> Iterator[Any]:
        frame = f"(0, 0) is the centre of the first pixel of camera {_label(camera.name)}; x right, y down"
        return self._series(pixels(self._columns, camera), frame, seconds, camera.name, unit="pixels")

    def _series(
        self, points: FloatArray, frame: str, seconds: FloatArray, key: str = "", **unit: Any
    ) -> Iterator[Any]:
        """Yield one series per point (N, P, 2 or 3); all share the timestamps of the first."""
        first: Any = None
        for name, values in zip(self._subject.point_names, np.moveaxis(points, 1, 0), strict=True):
            series = self._made(
                self._pose.PoseEstimationSeries,
                key=key,
                name=_label(name),
                data=values,
                confidence=self._columns["confidence"],
                confidence_definition=BY_NAME["confidence"].description,
                reference_frame=printable(frame),
                timestamps=seconds if first is None else first,
                **unit,
            )
            first = first or series
            yield series


def _label(name: str) -> str:
    """Return a name as NWB allows it."""
    return printable(name).strip("/").replace("/", "_").replace(":", "_")
