"""One robot's agent, and all that people run around it: the package of the command line `aucamp`."""
