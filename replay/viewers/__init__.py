"""Recordings and running fleets as other people's viewers want them."""
