"""Protocols of agreement against the Cramér-Rao bound, and against robots that lie."""
