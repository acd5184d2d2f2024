"""What ends a command with exit code 1: the question was good, and the answer is no."""


class Failed(RuntimeError):
    """What was asked for could not be done, through no mistake of the user's; one line that says why."""
