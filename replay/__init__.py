"""Recordings: the recorders, what happened in words, exports, and whole sweeps for reconstruction."""
