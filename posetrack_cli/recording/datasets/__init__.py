"""Recordings in the layouts of other tools and public datasets, one module each."""
