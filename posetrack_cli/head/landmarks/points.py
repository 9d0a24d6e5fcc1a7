"""The ten points of a face in files of landmarks: which of other programs' points each is.

| ours | of 68 (OpenFace, dlib, iBUG) | of 468 or 478 (MediaPipe) |
|---|---|---|
| right_eye_outer, right_eye_inner | 36, 39 | 33, 133 |
| left_eye_inner, left_eye_outer | 42, 45 | 362, 263 |
| right_mouth_corner, left_mouth_corner | 48, 54 | 61, 291 |
| right_nostril, left_nostril | 32, 34 | 97, 326 |
| right_brow_inner, left_brow_inner | 21, 22 | 55, 285 |

Right is the subject's. The programs' nostrils and brows are not quite ours; each point's constant offset
(``adjustment.offset_mm``) takes that up.
"""

from __future__ import annotations

from posetrack_cli.head.face.points import POINT_COUNT, POINT_NAMES
from posetrack_cli.recording.keypoints.kind import PointKind, by_index, same_order

OF_68 = (36, 39, 42, 45, 48, 54, 32, 34, 21, 22)
OF_478 = (33, 133, 362, 263, 61, 291, 97, 326, 55, 285)
"""The same of 468: the ten further ones are irises."""

FACE_POINTS = PointKind(
    subject="face",
    names=POINT_NAMES,
    counted={
        POINT_COUNT: same_order(POINT_COUNT),
        68: by_index(OF_68),
        468: by_index(OF_478),
        478: by_index(OF_478),
    },
    several=("faces", "multi_face_landmarks", "face_landmarks", "faceLandmarks"),
    command="posetrack head mono --help",
    ends=(POINT_NAMES[0], POINT_NAMES[-1]),
)
