"""Stereo disparity: the factor that converts it to depth."""

from __future__ import annotations

from posetrack_cli.errors import RecordingError
from posetrack_cli.mcap.decoding import CALIBRATION
from posetrack_cli.recording.camera_of import matrix_of
from posetrack_cli.recording.message_topics import FileTopics, Topic


def disparity_px_m(topics: FileTopics, images: Topic) -> float:
    """Return focal length times baseline, px m, of the stereo pair behind a disparity topic.

    Raises:
        RecordingError: no or several calibrations give it, or disparities are not floats in pixels.
    """
    calibrations = (topic.first for topic in topics.by_name.values() if topic.kind == CALIBRATION)
    projections = [matrix_of(one, "P", (3, 4)) for one in calibrations if one is not None]
    # P[0, 3] of the right camera is -f B, with baseline B to the left camera (sensor_msgs/CameraInfo)
    found = {round(-float(projection[0, 3]), 6) for projection in projections if projection is not None}
    baselines = [px_m for px_m in found if px_m > 0.0]
    if len(baselines) == 1 and images.image is not None and images.image.depth == "32FC1":
        return baselines[0]
    raise RecordingError(
        "disparity cannot be converted to depth",
        where=f"{topics.path}, {images.name}",
        found="several baselines" if baselines[1:] else images.label if baselines else "no baseline",
        expected="32FC1 and one calibration of the right camera with the baseline in P",
        hint="if it is depth, pass --depth-unit-mm",
    )
