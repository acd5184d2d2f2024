"""One robot's step: the order of the work, messages taken in, operators' orders, and the fleet file with its rules."""
