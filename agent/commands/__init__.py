"""What can be typed after `aucamp`: options in, one call out."""
