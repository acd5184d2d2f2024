"""The commands of `aucamp`: options in, one call out."""
