"""For the people in charge of a running fleet."""
