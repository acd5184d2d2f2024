"""The operator's page: a fleet, live or recorded, in a browser, and the orders that its buttons give."""
