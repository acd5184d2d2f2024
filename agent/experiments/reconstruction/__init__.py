"""Scenes from focus sweeps against the twin's truth: surface, picture and poses; and a map that robots share."""
