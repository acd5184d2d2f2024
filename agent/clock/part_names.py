"""Who takes part in a dive: of each robot the three threads of its agent that time waits for."""

LOOP, CAMERA, SERIAL = PARTS = ("loop", "camera", "serial")


def part_name(robot: str, part: str) -> str:
    """The name of a part, such as r1.loop."""
    return f"{robot}.{part}"
