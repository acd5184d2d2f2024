"""Recordings and running fleets as Foxglove and Rerun draw them."""
