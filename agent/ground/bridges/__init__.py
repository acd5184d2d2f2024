"""A running fleet for programs that speak MAVLink, ROS 2 or keelson."""
