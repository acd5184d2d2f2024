"""Cameras whose focus can be set: one protocol, and a backend for each kind of address."""
