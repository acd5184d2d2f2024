"""How far robots that lie as well as they can move the others, and whether these come back. A seed is one draw."""

from collections import defaultdict
from itertools import chain

from agent.experiments.claim import Claim, Figure, NoSettings, Quantile, Row, Rows, Share, Value
from tests.studies.liar.attack import LiarCase, Outcome, attacked, bumped
from tests.studies.liar.moving import attacked_moving

# --- cases: each has a few fleets; the names of these are in the figures' ---

CASES = {
    "mesh": {f"mesh-{robots}": LiarCase("full", robots) for robots in (3, 5, 10)},
    # The same where robots know that all ranges may be long by the same share: 0.15 %, and 0.2 % by the ball's radius.
    "budget": {f"budget-{robots}": LiarCase("full", robots, scale=0.0025) for robots in (3, 5, 10)},
    # Here a lie has to be passed on.
    "relayed": {"geometric-10": LiarCase("geometric", 10), "line-5": LiarCase("line", 5)},
    "key-gone": {f"key-gone-{robots}": LiarCase("full", robots, then="no key") for robots in (3, 5)},
    # A robot's own word counts where it is heard directly; elsewhere nothing stops a relay that changes it.
    "no-keys": {"no-keys-3": LiarCase("full", 3, keys=False), "no-keys-10": LiarCase("geometric", 10, keys=False)},
    # The target swims, and every lie binds the next.
    "moving": {f"moving-{robots}": LiarCase("full", robots, speed_mm_s=20.0) for robots in (3, 5, 10)},
    # Two of ten agree on their lies, and the fleet file reckons with two.
    "two-liars": {"two-of-10": LiarCase("full", 10, liars=2)},
    # One of three is knocked, for forty iterations no robot notices, then it is repaired and starts again.
    "bumped": {f"bumped-{mm}": LiarCase("full", 3, bumped_mm=float(mm)) for mm in (30, 100, 300)},
    # What the protocols that average beliefs have: a word from the far corner of the tank.
    "averaging": {
        "paper-10": LiarCase("full", 10, protocol="paper"),
        "metropolis-10": LiarCase("full", 10, protocol="metropolis"),
        "clip-3": LiarCase("full", 3, protocol="metropolis", clip=True),
        "clip-10": LiarCase("full", 10, protocol="metropolis", clip=True),
    },
}


def run(seed: int, case: str, settings: NoSettings) -> list[Row]:
    """A row for each fleet."""
    return [{"fleet": name, **told(outcome_of(fleet, seed))} for name, fleet in CASES[case].items()]


def outcome_of(fleet: LiarCase, seed: int) -> Outcome:
    if fleet.bumped_mm:
        return bumped(fleet, seed)
    return attacked_moving(fleet, seed) if fleet.speed_mm_s else attacked(fleet, seed)


def told(found: Outcome) -> Row:
    """Of the robot that is moved most; `after_10_mm`: what is left of it so many iterations after the lie."""
    return {
        "moved_mm": 1e3 * found.moved_m,
        "over_bound": found.ratio,
        "after_2_mm": 1e3 * found.after_m[1],
        "after_10_mm": 1e3 * found.after_m[9],
        "share": found.share,
    }


# --- figures ---

# Millimetres, by the number of robots.
AT_REST = {3: 22.0, 5: 8.0, 10: 5.0}
MOVING = {3: 20.0, 5: 18.0, 10: 8.0}
LONG: dict[int, float | None] = {3: None, 5: 1.1, 10: 1.1}  # times as far as without the scale, in half of the draws
BEYOND = 1.25  # times the bound, at most, in any draw
TRUTH_AGAIN_MM = 2.5  # at most, in any draw
KEY_GONE_MM = 0.1  # at most, in any draw
SHARE_AGAIN = 0.8  # of the weight of a robot that was never knocked
OFTEN = 95.0  # percent of draws


def summary(rows: Rows) -> dict[str, Value]:
    """Draws are independent, one a seed of each fleet. What holds in any draw is told as the share in which it does."""
    found: dict[str, Value] = {}
    draws: dict[str, list[Row]] = defaultdict(list)
    for row in chain(*rows.values()):
        draws[row["fleet"]].append(row)
    for fleet, of_fleet in draws.items():
        moved_mm = [row["moved_mm"] for row in of_fleet]
        found[f"{fleet}_often_mm"] = Quantile(moved_mm, OFTEN)
        found[f"{fleet}_half_mm"] = Quantile(moved_mm, 50.0)
        found[f"{fleet}_share"] = Quantile([row["share"] for row in of_fleet], 50.0)
    for robots in AT_REST:
        pairs = zip(draws[f"budget-{robots}"], draws[f"mesh-{robots}"], strict=False)
        ratios = [one["moved_mm"] / other["moved_mm"] for one, other in pairs]
        if ratios:
            found[f"budget-{robots}_ratio"] = Quantile(ratios, 50.0)
    for key, cases, name, limit in (
        ("within_bound", ("mesh", "relayed"), "over_bound", BEYOND),
        ("moving_within_bound", ("moving",), "over_bound", BEYOND),
        ("truth_again", ("mesh",), "after_10_mm", TRUTH_AGAIN_MM),
        ("key_gone", ("key-gone",), "after_2_mm", KEY_GONE_MM),
    ):
        values = [row[name] for case in cases for row in rows.get(case, ())]
        if values:
            found[key] = Share(sum(value <= limit for value in values), len(values))
    return found


CLAIM = Claim(
    run=run,
    summary=summary,
    cases=tuple(CASES),
    measured_on="model",
    figures=(
        Figure("mesh-3_often_mm", "one of 3 lies: the others are moved, 95 % of draws", "mm", most=AT_REST[3]),
        Figure("mesh-5_often_mm", "one of 5 lies", "mm", most=AT_REST[5]),
        Figure("mesh-10_often_mm", "one of 10 lies", "mm", most=AT_REST[10]),
        *(
            Figure(
                f"budget-{n}_ratio", f"one of {n} lies, robots know that ranges may be long: times as far", most=limit
            )
            for n, limit in LONG.items()
        ),
        Figure("geometric-10_often_mm", "one of 10 lies, on the hard graph", "mm", most=AT_REST[10]),
        Figure("line-5_often_mm", "one of 5 in a line lies", "mm"),
        Figure("within_bound", f"moved by at most {BEYOND:g} times the bound of single lies", "%", least=99.0),
        Figure("truth_again", f"truth told again: moved by <= {TRUTH_AGAIN_MM:g} mm 10 iterations on", "%", least=97.0),
        Figure("key_gone", f"key taken away: moved by <= {KEY_GONE_MM:g} mm 2 iterations on", "%", least=95.0),
        Figure("moving-3_often_mm", "target at 20 mm/s, one of 3 lies, 95 % of draws", "mm", most=MOVING[3]),
        Figure("moving-5_often_mm", "one of 5 lies", "mm", most=MOVING[5]),
        Figure("moving-10_often_mm", "one of 10 lies", "mm", most=MOVING[10]),
        Figure("moving_within_bound", f"moved by at most {BEYOND:g} times the bound", "%", least=95.0),
        Figure("bumped-30_share", "repaired after a knock of 30 mm: its weight, median", least=SHARE_AGAIN),
        Figure("bumped-100_share", "after a knock of 100 mm", least=SHARE_AGAIN),
        Figure("bumped-300_share", "after a knock of 300 mm", least=SHARE_AGAIN),
        Figure("two-of-10_often_mm", "two of 10 lie together, and the fleet reckons with two, 95 % of draws", "mm"),
        Figure("no-keys-3_half_mm", "one of 3 lies, nothing is signed, median", "mm"),
        Figure("no-keys-10_half_mm", "one of 10 on the hard graph, nothing is signed", "mm"),
        Figure("paper-10_half_mm", "the paper's protocol, one of 10 lies, median", "mm"),
        Figure("metropolis-10_half_mm", "Metropolis averaging, one of 10 lies", "mm"),
        Figure("clip-10_half_mm", "Metropolis averaging that clips, one of 10 lies", "mm"),
        Figure("clip-3_half_mm", "Metropolis averaging that clips, one of 3 lies", "mm"),
    ),
    seeds=60,  # as many as the 95 % take
    explanation="""In virtual time a robot knows all that the others measured and looks in each of twenty iterations for
        the lie that moves them most, within what every check lets through. It forges the words of all others too. The
        same fleet dives beside it with the same chance and no lie. Moved is how far the two place the target apart,
        of the robot that is worst off, at any time of the lie. The bound of single lies is one of theory, which no
        robot knows. A weight is that in what the others conclude, 1 for a robot that was never knocked.""",
)
