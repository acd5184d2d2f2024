"""Protocols of agreement against the Cramér-Rao bound, in a world where all robots go in lock-step."""
