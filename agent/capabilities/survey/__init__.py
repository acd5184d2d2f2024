"""Robots that map a tank together: which view to take next, what was seen, and how maps become equal."""
