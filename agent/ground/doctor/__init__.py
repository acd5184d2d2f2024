"""`aucamp doctor`: why robots, and who looks at them, do not hear each other."""
