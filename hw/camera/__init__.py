"""Cameras whose focus can be set: one protocol, one backend for each kind of address."""
