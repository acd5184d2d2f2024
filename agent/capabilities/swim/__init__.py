"""A robot that swims: its pose from tags and odometry, its behaviours, and the forces that it asks for."""
