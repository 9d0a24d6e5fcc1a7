"""How well a pose explains a frame, and the pose that does so best."""
