"""A surface as small coloured discs: pictures and depths of it at compiled speed, where there is no torch."""
