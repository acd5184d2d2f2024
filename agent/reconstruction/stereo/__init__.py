"""Depths by comparing pictures: what one view's windows look like from others, and where they fit."""
