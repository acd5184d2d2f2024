"""Zenoh sessions: base settings as data, what differs from process to process laid over them, and the one door."""
