"""Whether the ball is found in every kind of water."""
