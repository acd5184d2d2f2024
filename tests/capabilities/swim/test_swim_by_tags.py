"""All parts together: a robot put somewhere into a tank finds itself by tags alone, and swims where it shall."""

import math

import numpy as np

from agent.capabilities.swim.behaviour import reference, start, wanted_velocity, wrench
from agent.capabilities.swim.event_ring import EventRing, asked, fix
from agent.capabilities.swim.pose_filter import Drift, Hull, begin
from agent.capabilities.swim.search import Surroundings
from agent.capabilities.swim.tag_fix import TagFix, first_fix, priors, tag_fix
from agent.core.attitude import Attitude
from agent.core.config import Goto
from agent.core.linear_algebra import wrap
from tests.capabilities.swim.planar_tank import CYCLE_NS, Swimmer
from tests.capabilities.swim.tank_with_tags import MAP, VIEW, sight

LATE_NS = 100_000_000  # from the exposure to the step that has its tags


def test_a_robot_finds_itself_and_swims_to_a_place() -> None:
    rng, goal, tilt = np.random.default_rng(6), Goto(x_m=1.9, y_m=1.2, yaw_deg=40.0), math.radians(-35.0)
    swimmer = Swimmer.resting((1.4, 0.9, -2.5), Hull(drag2=16.0, mass_kg=6.5))
    ring, progress, frames, errors, done = None, None, [], [], False
    for step in range(180):
        now_ns = step * CYCLE_NS
        if step % 4 == 0:
            theta = (*map(float, swimmer.at), 0.3, 0.0, 0.0, 0.0, tilt)
            frames.append((now_ns, sight(theta, rng, most=3)))
        while frames and frames[0][0] + LATE_NS <= now_ns:
            exposed_ns, tags = frames.pop(0)
            before = priors(Attitude(0.3, 0.0, 0.0), (0.0, math.degrees(tilt)), 0.1, turning=False)
            if ring is None:
                found = first_fix(VIEW, before, MAP, tags)
                if isinstance(found, TagFix):
                    begun = begin(exposed_ns, found.theta[:3], found.fluctuates, found.stays)
                    ring = EventRing(begun, Hull(), Drift())
                continue
            found = tag_fix(VIEW, before, MAP, tags, ring.at(exposed_ns).pose)
            if isinstance(found, TagFix):
                ring.add(fix(exposed_ns, found.theta[:3], found.fluctuates, found.stays))
        force = (0.0, 0.0, 0.0)
        if ring is not None:
            ring.advance(now_ns)
            belief = ring.at(now_ns)
            progress = progress or start(belief.pose, 0.0, now_ns)
            to, progress = reference(goal, progress, belief.pose, now_ns, Surroundings((3.0, 2.0)))
            force, done = wrench(belief, Hull(), to, wanted_velocity(belief, to)), to.done
            ring.add(asked(now_ns, force))
            errors.append([*(np.subtract(belief.pose, swimmer.at)[:2]), wrap(belief.pose[2] - swimmer.at[2])])
        swimmer.swim(force, CYCLE_NS * 1e-9)
    assert done and len(errors) > 170
    assert np.hypot(swimmer.at[0] - 1.9, swimmer.at[1] - 1.2) < 0.02
    assert abs(math.degrees(wrap(swimmer.at[2] - math.radians(40.0)))) < 2.0
    assert np.percentile(np.hypot(*np.array(errors)[:, :2].T), 90) < 0.010
    assert ring.newest.restarts == ring.dropped == 0
