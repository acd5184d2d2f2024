"""What a lens under water throws on a sensor."""
