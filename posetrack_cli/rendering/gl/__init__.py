"""The OpenGL implementation of the renderers: context, shaders, tiles, textured surfaces."""
