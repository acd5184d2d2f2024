"""A recording against today's code."""
