"""Procedures that measure what a real camera, lens and gimbal do."""
