"""Before a fleet's first dive: a fleet file to begin with, and whether all is there that it names."""
