"""Draws on the processor, compiled: faster than OpenGL where that is drawn by the processor, too."""
