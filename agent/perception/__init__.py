"""Frames become sightings: the camera's thread, clarity, tags, optical flow, and the depth of whole views."""
