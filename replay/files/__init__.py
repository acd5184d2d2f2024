"""Recordings as MCAP files: their channels, and how they are written, read and mended."""
