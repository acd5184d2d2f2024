"""The simulated tank as a process: its ticks, boards, cameras, creatures, faults, scenes, and the truth."""
