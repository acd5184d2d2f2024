"""Whether measurements of a ball are as wrong as they say."""
