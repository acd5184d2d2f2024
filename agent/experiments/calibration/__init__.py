"""Range against focus position, on the twin's bench."""
