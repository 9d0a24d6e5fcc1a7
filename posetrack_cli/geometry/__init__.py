"""Rotations, rigid transforms and cameras, in mm and rad; camera axes x right, y down, z forward."""
