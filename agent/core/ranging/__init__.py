"""From the lens position of a focus peak and a pixel to a place in the world, with its covariance."""
