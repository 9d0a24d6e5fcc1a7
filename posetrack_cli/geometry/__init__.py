"""Rotations, rigid transforms and cameras. Millimetres, radians; camera axes x right, y down, z forward."""
