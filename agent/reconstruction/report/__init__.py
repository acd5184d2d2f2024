"""What a person sees of a reconstruction: a page, pictures, a film round it."""
