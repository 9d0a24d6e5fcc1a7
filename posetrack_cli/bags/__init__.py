"""Files of messages, whatever their container: MCAP, ROS 1 bags, ROS 2 databases and folders."""
