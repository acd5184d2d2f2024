"""A surface and its colours as a field that torch fits to all pictures at once; see docs/scene-image.md."""
