"""The track of one target: how it moves, what samples of any rank say of it, and how far tracks stand apart."""
