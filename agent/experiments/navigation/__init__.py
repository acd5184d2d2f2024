"""How well a robot that swims knows where it is, and does what it is told to."""
