"""How sharp a part of a frame is, and where over a sweep it is sharpest."""
