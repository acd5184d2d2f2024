"""A target followed from frame to frame in a box."""
