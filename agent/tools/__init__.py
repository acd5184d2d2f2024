"""Programs on pictures and cameras: calibration, maps of tags, depth maps, tracking, and training of LU2Net."""
