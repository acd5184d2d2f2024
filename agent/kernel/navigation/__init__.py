"""Where a robot is, how well that is known, and how it gets to where it wants to be."""
