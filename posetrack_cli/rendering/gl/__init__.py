"""OpenGL renderers: context, shaders, tiles, textured surfaces."""
