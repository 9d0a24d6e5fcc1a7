"""Camera calibration from images of a board: detection, intrinsics, extrinsics, errors."""
