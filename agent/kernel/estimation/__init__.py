"""Agreement on where the target is: one face, one file per protocol."""
