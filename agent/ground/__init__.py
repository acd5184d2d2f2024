"""For the people in charge of a fleet: orders, checks before a dive, doctor, keys, pictures and recordings."""
