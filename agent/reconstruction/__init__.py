"""Scenes in three dimensions from recordings: poses, surface, image model, and files for other programs."""
