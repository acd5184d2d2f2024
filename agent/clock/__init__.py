"""What time it is, and waiting for it: the only room of the house that asks the machine's clock.

Robots with real devices live by the system's clock; a dive in the twin has a clock of its own, which every process of
that dive follows and none runs ahead of.
"""
