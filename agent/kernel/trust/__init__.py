"""Whose word counts, in which epoch, and when it was said: what others cannot make up."""
