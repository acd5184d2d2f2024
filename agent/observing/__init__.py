"""For whoever looks at a running fleet: one picture of a robot, and what its messages look like."""
