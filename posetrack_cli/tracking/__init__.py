"""Tracking runs over a recording, shared by all trackers: loop, run record, checkpoints."""
