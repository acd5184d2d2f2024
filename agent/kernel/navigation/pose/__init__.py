"""What a robot knows of its own motion: forces, landmarks and odometry in one filter, whenever they arrive."""
