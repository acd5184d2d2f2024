"""The operator's page: a fleet, live or recorded, in a browser on this machine."""
