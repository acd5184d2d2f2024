"""How well a robot that swims knows its pose, and does what it is told."""
