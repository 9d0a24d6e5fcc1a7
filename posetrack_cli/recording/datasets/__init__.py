"""Recordings as other tools and public datasets store them: each layout in a module of its own."""
