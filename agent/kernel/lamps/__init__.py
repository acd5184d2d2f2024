"""Lamps in a robot's step: how its own burns, whose light it asks for, and which sweeps count by it."""
