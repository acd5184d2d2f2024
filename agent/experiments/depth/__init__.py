"""Depth of whole views from focus, against the twin's truth."""
