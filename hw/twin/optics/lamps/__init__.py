"""What lamps do in the water: light on surfaces, veil in front of them, and the camera's exposure in the dark."""
