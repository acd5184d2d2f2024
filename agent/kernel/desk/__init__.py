"""A robot and people: what they are shown of it, and what they order, judged, remembered and carried out."""
