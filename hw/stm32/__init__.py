"""The control module at the end of the tether, as its host sees it."""
