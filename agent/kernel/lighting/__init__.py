"""Whose lamps burn while a robot sweeps: a lamp's light and veil, what a sweep is worth in them, which lamps to ask for."""
