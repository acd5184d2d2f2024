"""What a camera under water sees: rays, light, lamps and their veil, lens and sensor."""
