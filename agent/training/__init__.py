"""Training data, losses and the loop that make LU2Net's weights, and the figures by which an enhancement is judged."""
