"""Devices and their twin: cameras, the control module and its firmware, the simulated tank."""
