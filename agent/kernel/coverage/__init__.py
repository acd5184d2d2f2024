"""What of the tank has been seen, and how well: keyframes that robots share, a map of integers that they make equal,
and where to look next."""
