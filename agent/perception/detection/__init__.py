"""A target found in one frame: a ball, a coloured creature, or a thing in a box."""
