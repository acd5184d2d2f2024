"""Orders that are in force, and what carrying one out means; who may give it, and when, is judged before (desk.py)."""

from __future__ import annotations

from agent.capabilities.light.allocate import OrderedLight
from agent.capabilities.light.lights import Lights
from agent.capabilities.swim.swimmer import Swimmer
from agent.core.codec import Refusal
from agent.core.config import Behaviour, Fleet, Goto, Hold, Survey
from agent.core.step_io import Motors, TargetBox
from agent.core.step_transaction import SURFACE_M, Revertible
from agent.robot.swim_rules import wrong_way
from agent.robot.verbs import Args, Arm, Burn, Clock, Disarm, DrawBox, HoldHere, LookAt, Resume, Set, Stop, Surface
from agent.robot.wishes import AtOnce, Wishes, prevailing

MOST_SEND_HZ, LEAST_SEND_HZ, MOST_PREVIEW_HZ = 20.0, 0.2, 5.0
MIN_SIDE_PX = 8.0  # of a box that can be followed


class Doing(Revertible):
    """Of one robot, between steps."""

    def __init__(self, fleet: Fleet, name: str, swimmer: Swimmer | None, lights: Lights) -> None:
        self._fleet, self._robot, self._swimmer = fleet, fleet.robot[name], swimmer
        self._lights = lights
        self.wishes, self.at_once = Wishes(), AtOnce()

    def carry_out(self, what: Args) -> None:
        """Raises Refusal for what this robot cannot do, and then does nothing."""
        match what:
            case Stop() | Disarm() | Surface():
                self.halt("surface" if isinstance(what, Surface) else "stop")
            case Arm():
                self._motors("arm")
            case Clock():
                pass
            case HoldHere():
                self._hold(what)
            case LookAt():
                body = self._fleet.body
                within("pan_deg", what.pan_deg, *body.pan_limit_deg)
                within("tilt_deg", what.tilt_deg, *body.tilt_limit_deg)
                self.wishes = self.wishes._replace(gaze_deg=(what.pan_deg, what.tilt_deg))
            case Burn():
                self._burn(what)
            case DrawBox():
                self._draw(what)
            case Set():
                self._set(what)
            case Resume():
                self._resume()
            case _:
                self._swim(what)

    def halt(self, verb: str) -> None:
        """Stop, disarm or surface; nothing can be wrong with it."""
        self._motors("surface" if verb == "surface" else "off")

    def _motors(self, ordered: Motors) -> None:
        self.at_once = self.at_once._replace(motors=prevailing(self.at_once.motors, ordered))

    def _hold(self, what: HoldHere) -> None:
        if what.depth_m is not None:
            self._dive(what.depth_m)
        if self._swimmer is not None:
            self._swimmer.task.begin(Hold())
            self.wishes = self.wishes._replace(behaviour=Hold())

    def _burn(self, what: Burn) -> None:
        if self._lights.own is None or not self._robot.lamp:
            raise Refusal("content", "it has no lamp: `lamp = true` is not in its table of the fleet file")
        body = self._fleet.body
        within("pan_deg", what.pan_deg, *body.pan_limit_deg)
        within("tilt_deg", what.tilt_deg, *body.tilt_limit_deg)
        self._lights.own.ordered = OrderedLight(what.light, what.pan_deg, what.tilt_deg)

    def _draw(self, what: DrawBox) -> None:
        boxed = [name for name, target in self._fleet.target.items() if target.detector == "box"]
        if not boxed:
            raise Refusal("content", 'no target of the fleet file has detector = "box"; others are found by colour')
        target = what.target or boxed[0]
        if target not in boxed or (what.target is None and len(boxed) > 1):
            raise Refusal("content", f"target: write one of {', '.join(boxed)}")
        size = self._fleet.camera.width_px, self._fleet.camera.height_px
        if min(what.width, what.height) < MIN_SIDE_PX:
            raise Refusal("content", f"a box of less than {MIN_SIDE_PX:g} pixels cannot be followed; draw a larger one")
        if what.x + what.width > size[0] or what.y + what.height > size[1]:
            raise Refusal("content", f"the box is not within the frame, {size[0]} x {size[1]} pixels")
        box = TargetBox(target=target, frame=what.frame, box=(what.x, what.y, what.width, what.height))
        self.at_once = self.at_once._replace(box=box)

    def _set(self, what: Set) -> None:
        match what.name:
            case "sweeps":
                if what.value not in (0.0, 1.0):
                    raise Refusal("content", "value: 1 is on, 0 is off")
                self.wishes = self.wishes._replace(sweeps=bool(what.value))
            case "send_hz":  # heard less often, neighbours would leave it out
                within("value", what.value, max(LEAST_SEND_HZ, 1.0 / self._fleet.estimation.validity_s), MOST_SEND_HZ)
                self.wishes = self.wishes._replace(send_hz=what.value)
            case "preview_hz":
                within("value", what.value, 0.0, MOST_PREVIEW_HZ)
                self.at_once = self.at_once._replace(preview_hz=what.value)
            case "speed_m_s":
                if self._swimmer is None or self._fleet.navigation is None:
                    raise Refusal("content", MOORED)
                within("value", what.value, 0.01, self._fleet.navigation.limits.speed_m_s)
                self._swimmer.limit_speed(what.value)

    def _resume(self) -> None:
        self.wishes = Wishes()
        self.at_once = self.at_once._replace(preview_hz=self._fleet.link.preview_hz)
        if self._lights.own is not None:
            self._lights.own.ordered = None
        if self._swimmer is not None and self._fleet.navigation is not None:
            self._swimmer.task.resume()
            self._swimmer.dive(self._robot.depth_m)
            self._swimmer.limit_speed(self._fleet.navigation.limits.speed_m_s)

    def _swim(self, what: Behaviour) -> None:
        """A behaviour, as a fleet file has it."""
        if isinstance(what, Survey) and not isinstance(self._robot.behaviour, Survey):
            raise Refusal(
                "content", "its behaviour in the fleet file is no survey, so that it has not chosen any views"
            )
        if self._swimmer is None:
            raise Refusal("content", MOORED)
        if (wrong := wrong_way(self._fleet, what)) is not None:
            raise Refusal("content", wrong)
        if isinstance(what, Goto) and what.depth_m is not None:
            self._within_water(what.depth_m)
        self.wishes = self.wishes._replace(behaviour=what)
        self._swimmer.task.begin(what)

    def _dive(self, depth_m: float) -> None:
        self._within_water(depth_m)
        if self._swimmer is not None:
            self._swimmer.dive(depth_m)
        self.wishes = self.wishes._replace(depth_m=depth_m)

    def _within_water(self, depth_m: float) -> None:
        within("depth_m", depth_m, SURFACE_M, self._fleet.tank.surface_m)


MOORED = "it is moored: its fleet file has no [navigation]"


def within(name: str, value: float, lowest: float, highest: float) -> None:
    """Raises Refusal for a value that is not."""
    if not lowest <= value <= highest:
        raise Refusal("content", f"{name}: {value:g} is not within {lowest:g} to {highest:g}")
