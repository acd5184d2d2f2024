"""Surfaces and views in the formats of other programs."""
