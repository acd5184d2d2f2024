"""A target found in one frame."""
