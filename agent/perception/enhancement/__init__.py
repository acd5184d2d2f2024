"""Frames as they would look without the water."""
