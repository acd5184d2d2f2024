"""`aucamp demo`: a whole dive in the twin on this computer, its processes, what is shown and what it was worth."""
