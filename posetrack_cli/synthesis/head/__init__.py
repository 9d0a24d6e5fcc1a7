"""Synthetic recordings of a head of our own making, as one or two grey cameras see it, with truth.

``frames.synthesise(options)`` yields frames, ``writing.write_synthetic(options, path)`` writes a file or a
folder. A recording is a function of its options::

    options -> Plan (person, movement, expressions, light) -> Scene, sensors -> SyntheticHeadFrame -> MCAP

A head is one grid of vertices that every person shares. In the average head's own coordinates it gets a
relief, is painted and deforms; a person's proportions then bend it so that the ten points lie where they
shall.
"""
