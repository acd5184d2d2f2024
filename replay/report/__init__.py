"""A run on one page: what came of it, its tables and its figures."""
