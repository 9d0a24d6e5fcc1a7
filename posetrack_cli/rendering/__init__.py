"""The GL context and the tiled depth renderer. Knows meshes and cameras, not hands."""
