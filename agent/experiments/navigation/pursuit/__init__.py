"""Robots that follow a target, or look for one."""
