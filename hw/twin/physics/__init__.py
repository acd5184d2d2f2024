"""Bodies in water: forces, sensors, thrusters, the tank's walls."""
