"""Recordings as files: written, read, mended."""
