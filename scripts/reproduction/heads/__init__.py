"""What the stereo head tracker reaches, part by part."""
