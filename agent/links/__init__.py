"""What a robot's links bring, before a step takes it."""
