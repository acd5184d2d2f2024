"""Scenes in three dimensions from recordings: views, their fusion into a surface, what other programs read of it."""
