"""One robot's mind: the same inputs at the same times give the same bytes. No clock, chance, thread or device."""
