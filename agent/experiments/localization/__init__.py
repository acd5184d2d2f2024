"""Protocols of agreement against the Cramér-Rao bound."""
