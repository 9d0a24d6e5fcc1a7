"""Synthetic head recordings by one or two grey cameras, with ground truth; heads are procedural.

``frames.synthesise(options)`` yields frames, ``writing.write_synthetic(options, path)`` writes a file or a
folder. A recording is a function of its options::

    options -> Plan (person, movement, expressions, light) -> Scene, sensors -> SyntheticHeadFrame -> MCAP

All persons share one grid of vertices. Relief, texture and deformations are defined in the coordinates of
the average head; a person's proportions then warp it so that the ten landmarks are at the required places.
"""
