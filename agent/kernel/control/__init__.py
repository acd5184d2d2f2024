"""What the robot does next: where the lens goes, where the gimbal points."""
