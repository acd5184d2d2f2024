"""Robots that lend each other their lamps in dark water: which lamps burn, for whom, and for how long."""
