"""What the one-camera head tracker reaches, and the thesis's experiments A, B and C."""
