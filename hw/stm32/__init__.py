"""The control module as its host sees it: the port's thread, the conversation, and the switch for motors."""
