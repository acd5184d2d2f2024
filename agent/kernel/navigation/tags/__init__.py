"""From landmarks in a frame to the pose of the robot that saw them."""
