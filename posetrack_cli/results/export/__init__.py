"""Export of results to formats of other tools: CSV, TUM, JSON, numpy, C3D, ROS 2."""
