"""Bodies in water: forces, thrusters, sensors, and the tank's walls."""
