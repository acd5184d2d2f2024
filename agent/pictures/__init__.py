"""Verbs on pictures, a camera's or a file's: depth maps, following a box, enhancing."""
