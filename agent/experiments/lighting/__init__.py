"""Robots that light for each other: what a neighbour's lamp is worth, and how well the models of light are known."""
