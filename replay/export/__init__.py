"""Recordings for other programs: spreadsheets, film players, scripts."""
