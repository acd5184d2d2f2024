"""Scenes from focus sweeps against the twin's truth: surface, picture and poses."""
