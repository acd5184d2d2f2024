"""A fleet as vehicles of MAVLink, for ground stations."""
