"""Protocols of agreement: own measurements and neighbours' messages become one posterior of a target."""
