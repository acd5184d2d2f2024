"""How time and memory grow with a survey: seven robots over a floor of 10 x 6 m, whose depths are drawn, not swept."""
