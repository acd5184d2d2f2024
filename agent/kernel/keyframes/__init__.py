"""What robots say to each other of what they saw: keyframes, and claims on the next."""
