"""Files of messages in any container: MCAP, ROS 1 bags, ROS 2 databases and folders."""
