"""Whose lamps burn while robots follow what swims: the rule, and what comes of it where each knows a little else."""

import math
from collections.abc import Mapping
from itertools import pairwise, permutations
from random import Random

from agent.capabilities.light.allocate import Scene
from agent.capabilities.light.followers import HOLD_NS, MOST, Held, View, best, decided, followers, view
from agent.core.config import Lighting, WaterOptics
from agent.core.messages import Vector

HARBOUR = Lighting(water=WaterOptics(absorption_per_m=(0.55, 0.37, 0.45), scattering_per_m=(1.82,) * 3))
COASTAL = Lighting(water=WaterOptics(absorption_per_m=(0.25, 0.18, 0.35), scattering_per_m=(0.22,) * 3))
GAIN = HARBOUR.gain
FISH_M = (1.5, 1.0, 0.2)
RADIUS_M, BESIDE_M, UP_M = 0.075, 0.12, 0.25
STEP_NS, LATE_STEPS = 50_000_000, 4


def around(
    *turns_deg: float, far_m: float, lighting: Lighting = HARBOUR, random: Random | None = None
) -> dict[str, View]:
    """Views of robots r0, r1 .. at those bearings from a fish that they look at; random: where they take all that to
    be, 2 cm off."""

    def taken(at_m: float) -> float:
        return at_m if random is None else random.gauss(at_m, 0.02)

    fish_m = taken(FISH_M[0]), taken(FISH_M[1]), FISH_M[2]
    cameras_m, lamps_m = dict[str, Vector](), dict[str, Vector]()
    for k, turn in enumerate(map(math.radians, turns_deg)):
        x, y = taken(FISH_M[0] + far_m * math.cos(turn)), taken(FISH_M[1] + far_m * math.sin(turn))
        cameras_m[f"r{k}"] = x, y, UP_M
        lamps_m[f"r{k}"] = x + BESIDE_M * math.sin(turn), y - BESIDE_M * math.cos(turn), UP_M
    return {name: view(scene(at_m, fish_m), lamps_m, lighting) for name, at_m in cameras_m.items()}


def scene(camera_m: Vector, fish_m: Vector) -> Scene:
    away_m = math.dist(camera_m, fish_m)
    x, y, z = ((to - at) / away_m for to, at in zip(fish_m, camera_m, strict=True))
    return Scene(camera_m, (x, y, z), fish_m, RADIUS_M, 1169.0, 0.7 * away_m**2)


def seen_by(views: Mapping[str, View], *lamps: str) -> float:
    return followers(views.values(), frozenset(lamps))


def test_all_around_it_one_stays_dark_and_more_see_it() -> None:
    views = around(0.0, 120.0, 240.0, far_m=0.7)
    found, by_it = best(views.values(), views)
    assert len(found) == 2 and by_it > seen_by(views, *views) + 0.3


def test_one_lights_for_the_other_where_no_lamp_shows_it_to_its_own_camera() -> None:
    views = around(0.0, 60.0, far_m=1.15)
    found, _ = best(views.values(), views)
    (lamp,), (other,) = found, set(views) - found
    assert seen_by({other: views[other]}, lamp) > 0.4
    assert not seen_by({lamp: views[lamp]}, lamp) and not seen_by({other: views[other]}, other)
    assert seen_by({other: views[other]}, lamp, other) < 0.5 * seen_by({other: views[other]}, lamp)


def test_whoever_looks_into_a_lamp_sees_nothing() -> None:
    views = around(0.0, 165.0, far_m=0.7)
    assert views["r0"].dazzled_by == {"r1"} and views["r1"].dazzled_by == {"r0"}
    assert not seen_by(views, "r0", "r1")
    assert seen_by({"r0": views["r0"]}, "r0") > 0.9
    assert len(best(views.values(), views)[0]) == 1


def test_in_clear_water_close_by_all_may_burn() -> None:
    views = around(0.0, 60.0, far_m=0.6, lighting=COASTAL)
    assert seen_by(views, *views) > 1.8
    assert seen_by(views, *views) >= best(views.values(), views)[1]


def test_nothing_is_shown_without_a_lamp_or_to_nobody() -> None:
    views = around(0.0, far_m=0.6)
    assert not seen_by(views) and not followers((), frozenset({"r0"}))
    assert best(views.values(), ())[0] == frozenset() and not best((), views)[1]


def test_it_is_the_same_whatever_the_order_and_never_more_than_the_most() -> None:
    views = around(0.0, 70.0, 140.0, 210.0, 290.0, far_m=0.75)
    found = best(views.values(), views)
    assert 1 <= len(found[0]) <= MOST
    for names in list(permutations(views))[::17]:
        assert best([views[name] for name in names], names) == found


def test_another_set_has_to_be_better_for_half_a_second_without_a_break() -> None:
    views = around(0.0, 120.0, 240.0, far_m=0.7)
    everyone, found = frozenset(views), best(views.values(), views)[0]

    def at(held: Held, now_ns: int, gain: float = GAIN) -> Held:
        return decided(held, views.values(), views, everyone, gain, now_ns)

    first = at(Held(), STEP_NS)
    assert first == Held(everyone, STEP_NS)
    assert at(first, STEP_NS + HOLD_NS - 1) == first
    assert at(first, STEP_NS + HOLD_NS).lamps == found
    broken = at(first, 2 * STEP_NS, gain=5.0)  # no set gains so much
    assert broken == Held(everyone, None)
    assert at(broken, STEP_NS + HOLD_NS).lamps == everyone


def test_who_lends_nothing_leaves_all_lamps_as_they_are() -> None:
    views = around(0.0, 120.0, 240.0, far_m=0.7)
    held = Held()
    for step in range(100):
        held = decided(held, views.values(), views, frozenset(views), 1e9, step * STEP_NS)
    assert held.lamps == set(views)


def test_lamps_of_robots_that_know_it_a_little_otherwise_do_not_flicker() -> None:
    """Each takes places to be 2 cm off, each time anew, and hears of others' lamps 0.2 s late. The fish is all but in
    the middle, so that many sets are worth the same."""
    random, names = Random(4), ("r0", "r1", "r2")
    held, burns = {name: Held() for name in names}, [set(names)]
    for step in range(400):
        late = burns[max(len(burns) - LATE_STEPS, 0)]
        for name in names:
            views = around(0.0, 120.0, 240.0, far_m=0.7, random=random)
            burning = frozenset((late - {name}) | (burns[-1] & {name}))
            held[name] = decided(held[name], views.values(), views, burning, GAIN, step * STEP_NS)
        burns.append({name for name in names if name in held[name].lamps})
    changes = sum(one != other for one, other in pairwise(burns))
    truth, settled = around(0.0, 120.0, 240.0, far_m=0.7), burns[60:]
    assert changes <= 10, changes
    mean = sum(seen_by(truth, *lamps) for lamps in settled) / len(settled)
    assert mean > seen_by(truth, *names) + 0.3
