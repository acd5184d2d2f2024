"""TargetScheduler of the camera: robots that share an index agree on whose turn it is, and nobody starves."""

from agent.core.control.target_search import PATIENCE, TURN, TargetScheduler

THREE = ("ball", "buoy", "fish")


def test_one_target_has_every_turn() -> None:
    turns = TargetScheduler(("ball",))
    assert {turns.next({"ball": t}) for t in range(50)} == {"ball"}


def test_each_has_its_turn_in_the_order_of_the_fleet_file() -> None:
    turns, t, seen = TargetScheduler(THREE), dict.fromkeys(THREE, 0), []
    for _ in range(2 * len(THREE) * TURN):
        t[turns.target] += 1
        seen.append(turns.target)
        turns.next(t)
    assert seen == [name for _ in range(2) for name in THREE for _ in range(TURN)]


def test_a_restarted_robot_joins_the_turn_of_the_others() -> None:
    turns = TargetScheduler(THREE)
    t = {"ball": 3 * TURN, "buoy": 2 * TURN + 2, "fish": 2 * TURN}  # after its first iteration, indices adopted
    assert turns.next(t) == "fish"
    turns = TargetScheduler(THREE)
    assert turns.next({**t, "fish": 3 * TURN}) == "buoy"
    assert turns.next({**t, "fish": 3 * TURN, "buoy": 3 * TURN - 1}) == "buoy"
    assert turns.next({**t, "fish": 3 * TURN, "buoy": 3 * TURN}) == "ball"


def test_a_target_whose_index_others_drive_is_looked_at_all_the_same() -> None:
    turns, t, waited, longest = TargetScheduler(THREE), dict.fromkeys(THREE, 0), 0, 0
    for _ in range(200):
        t["buoy"] += 3  # by a neighbour that knows nothing else
        t[turns.target] += 1
        waited = 0 if turns.next(t) == "buoy" else waited + 1
        longest = max(longest, waited)
    assert longest <= (PATIENCE * len(THREE) + 1) * TURN
