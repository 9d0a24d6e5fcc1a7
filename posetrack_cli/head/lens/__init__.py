"""Focal length of a camera without calibration, estimated from the face, and its uncertainty **[ours]**."""
