"""A thing in a box followed from frame to frame: where it is, whether it is lost, and where it is found again."""
