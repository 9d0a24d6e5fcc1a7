"""Export of results to formats of other tools: tables, arrays, NWB, BIDS, C3D, ROS 2."""
