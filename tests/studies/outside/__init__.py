"""The twin before programs that nobody here wrote."""
