"""What claims of networks count of their rows, and the fleets that they make."""

from pathlib import Path

from agent.experiments.claim import Quantile, Share
from agent.robot.fleet_reader import load_fleet
from tests.bench import bench_swarm
from tests.bench.network import bench_hosts, bench_orders
from tests.bench.network.processes import made


def test_the_slowest_answer_of_a_run_counts() -> None:
    row = {"answer_ms": 25.0, "slowest_ms": 60.0, "named_s": 1.0, "others_ms": 30.0}
    found = bench_orders.summary({"tcp": [row, {**row, "slowest_ms": 160.0}]})
    assert found["tcp_in_time"] == Share(1, 2) and found["tcp_named"] == Share(2, 2)
    assert found["tcp.slowest_ms"] == Quantile([60.0, 160.0], 50.0)
    assert not any(key.startswith("tls") for key in found)


def test_every_renewal_counts() -> None:
    rows = [{"agreed_s": 8.0, "heard_per_s": 40.0}, {"renewed_s": 0.7}, {"renewed_s": 2.5}]
    assert bench_hosts.summary({"tls": rows})["renewed"] == Share(1, 2)


def test_a_swarm_without_places_does_not_agree() -> None:
    assert not bench_swarm.agreed({})


def test_neighbours_are_near_along_a_ring(tmp_path: Path) -> None:
    one = made(tmp_path, "tcp", range(20000, 20006), reach=1)
    assert load_fleet(one.path).robot["r1"].neighbours == ("r2", "r6")
    everybody = made(tmp_path / "all", "tls", range(20000, 20003)).fleet
    assert everybody.robot["r2"].neighbours == ("r1", "r3") and everybody.secured
