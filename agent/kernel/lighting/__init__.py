"""Whose lamps burn while a robot sweeps: light and veil of a lamp, what a sweep is worth in them, which lamps."""
