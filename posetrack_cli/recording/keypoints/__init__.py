"""Keypoint files of other programs: points per frame, of hands or faces.

``layout`` defines point names, column names and keypoint sets; ``formats`` reads CSV and JSON; ``reading``
determines units and matches sets to frames.
"""
