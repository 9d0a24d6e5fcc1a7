"""The ten points of a face in files of landmarks: which of other programs' points each is.

The programs' nostrils and brows are not quite ours; each point's constant offset
(``adjustment.adjuster.OFFSET_SD_MM``) takes that up. ``docs/landmarks.md`` shows the same table.
"""

from __future__ import annotations

from posetrack_cli.head.face.points import POINT_COUNT, POINT_NAMES
from posetrack_cli.recording.keypoints.kind import PointKind, by_index, same_order

THEIRS = {
    "right_eye_outer": (36, 33),
    "right_eye_inner": (39, 133),
    "left_eye_inner": (42, 362),
    "left_eye_outer": (45, 263),
    "right_mouth_corner": (48, 61),
    "left_mouth_corner": (54, 291),
    "right_nostril": (32, 97),
    "left_nostril": (34, 326),
    "right_brow_inner": (21, 55),
    "left_brow_inner": (22, 285),
}
"""Of each of ours, which of 68 points (OpenFace, dlib, iBUG) and which of MediaPipe's 468 or 478 it is."""
OF_68, OF_478 = (tuple(THEIRS[name][k] for name in POINT_NAMES) for k in range(2))

FACE_POINTS = PointKind(
    subject="face",
    names=POINT_NAMES,
    counted={
        POINT_COUNT: same_order(POINT_COUNT),
        68: by_index(OF_68),
        70: by_index(OF_68),
        468: by_index(OF_478),
        478: by_index(OF_478),
    },
    several=("faces", "multi_face_landmarks", "face_landmarks", "faceLandmarks"),
    command="posetrack head mono --help",
    flat={"face_keypoints_2d": ""},
    parts={"": slice(23, 91)},
    ends=(POINT_NAMES[0], POINT_NAMES[-1]),
)
