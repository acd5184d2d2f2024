"""What swims in the tank by itself: how it steers, the shape that it has meanwhile, and the truth about it."""
