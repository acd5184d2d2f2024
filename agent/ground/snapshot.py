"""`aucamp snapshot`: the next picture that a running robot shows, as it comes."""

from __future__ import annotations

from pathlib import Path

from agent.clock import machine
from agent.core.codec import Refusal, decode
from agent.core.config import Fleet
from agent.core.messages import Image, State
from agent.core.topics import IMAGE, STATE
from agent.process.failure import Failed
from agent.process.transport import Observer

HEARD_S = 3.0  # of the wall: states come five times a second, and a link is there in less than one
PICTURE_S = 10.0  # between two sweeps a whole frame is seldom further away, also in a dive at a quarter of its speed
LOOK_S = 0.02


def next_picture(fleet: Fleet, robot: str, keys: Path | None = None) -> Image:
    """The robot's next preview. Raises Failed, one line that says what is wrong, where none comes.

    `keys`: folder of a secured fleet's certificates.
    """
    state, refused, start_s = None, "", machine.monotonic_s()
    with Observer(fleet, machine.monotonic_ns, (IMAGE, STATE), keys=keys) as observer:
        while (waited_s := machine.monotonic_s() - start_s) < PICTURE_S:
            for seen in observer.drain():
                if seen.chunks["robot"] != robot:
                    continue
                try:
                    if seen.topic is IMAGE:
                        return decode(seen.payload, Image, IMAGE.limit)
                    state = decode(seen.payload, State)
                except Refusal as refusal:
                    refused = str(refusal)
            if waited_s > HEARD_S and (why := hopeless(fleet, robot, state, refused)):
                raise Failed(why)
            machine.sleep(LOOK_S)
    raise Failed(
        f"{robot} is heard, but showed no picture in {PICTURE_S:.0f} s: while it sweeps its lens it reads parts of "
        f"frames alone; try again"
    )


def hopeless(fleet: Fleet, robot: str, state: State | None, refused: str) -> str:
    """Why no picture is to be expected; empty: it may still come."""
    if state is None and refused:
        return (
            f"{robot} is heard, but its messages cannot be read ({refused}); use the same version of aucamp as it has"
        )
    if state is None:
        where = fleet.robot[robot].listen
        return (
            f"{robot} is not heard at {where}: start its agent, or give the fleet file that it was started with "
            f"(a demo's is in its run's folder)"
        )
    if fleet.link.preview_hz == 0:
        return f"{robot} is heard, but shows no pictures: [link] preview_hz is 0; set it, and start the agent again"
    blind = [fault for fault in state.faults if fault.startswith(("no camera", "no frames"))]
    return f"{robot} is heard, but has no picture: {'; '.join(blind)}" if blind else ""


def about(path: Path, image: Image) -> str:
    """The picture in one line."""
    lens = "lens position not known" if image.focus is None else f"lens position {image.focus}"
    made = "enhanced" if image.enhanced else "as the camera gave it"
    return (
        f"{path}: frame {image.frame} of {image.robot}, {image.width_px}x{image.height_px} pixels, "
        f"{len(image.jpeg) / 1e3:.0f} kB, {lens}, {made}"
    )


def target_table(fleet: Fleet, name: str, path: Path, image: Image) -> str:
    """What to put into the fleet file so that robots look for a thing in this picture. Raises Failed for a picture
    that is none for that."""
    if image.enhanced:
        raise Failed(f"{path}: enhanced, and robots look at raw frames; set [camera] enhance = false and take another")
    if (image.width_px, image.height_px) != (fleet.camera.width_px, fleet.camera.height_px):
        raise Failed(
            f"{path}: a preview of {image.width_px}x{image.height_px} pixels, and a target needs the camera's full "
            f"{fleet.camera.width_px}x{fleet.camera.height_px}; take the picture with another program"
        )
    return (
        f"\n[target.{name}]\n"
        'detector = "box"\n'
        f'picture = "{path.name}"   # beside the fleet file\n'
        "box = [X, Y, WIDTH, HEIGHT]   # around the thing in it: pixels from the upper left corner"
    )
