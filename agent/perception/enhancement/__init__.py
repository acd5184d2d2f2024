"""Frames as they would look without the water: LU2Net, and classical ways where torch is not installed."""
