"""A dive of the twin's, with nothing but this computer: its fleet, its processes, what is shown and summed up."""
