"""A dive told in words, from one recording."""
