"""When a swarm agrees, and the fleets that claims of networks make."""

from pathlib import Path

from agent.robot.fleet_reader import load_fleet
from tests.bench import bench_swarm
from tests.bench.network.processes import made


def test_a_swarm_without_places_does_not_agree() -> None:
    assert not bench_swarm.agreed({})


def test_neighbours_are_near_along_a_ring(tmp_path: Path) -> None:
    one = made(tmp_path, "tcp", range(20000, 20006), reach=1)
    assert load_fleet(one.path).robot["r1"].neighbours == ("r2", "r6")
    everybody = made(tmp_path / "all", "tls", range(20000, 20003)).fleet
    assert everybody.robot["r2"].neighbours == ("r1", "r3") and everybody.secured
