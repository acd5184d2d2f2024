"""A fleet as nodes of ROS 2 over rmw_zenoh: for whoever has ROS; here there is none."""
