"""Meshes and renderers (interface ``port``; ``gl`` and ``cpu``), independent of hands and heads."""
