"""Synthetic hand recordings: the paper's random walks or natural motion, seen by a Kinect, with truth.

``frames.synthesise(options)`` yields frames, ``frames.write_synthetic(options, path)`` writes a file. A
recording is a function of its options::

    options: SynthOptions -> Plan (instants, motion) -> Scene, room, sensor -> SyntheticHandFrame -> MCAP
"""
