"""Zenoh sessions: base settings as data, what each process lays over them, access rules, and the session itself."""
