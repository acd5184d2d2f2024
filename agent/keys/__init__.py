"""Who measured what: each robot's pair of signing keys, made, read, watched and used."""
