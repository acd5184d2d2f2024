"""What a relay does to packets, without a network: rate, queue, and losses in bursts."""

from itertools import groupby

import pytest

from tests.network.relay import Links, Relay

AT_S = 1024.0


def packet(relay: Relay, dst: str, length: int, syn: bool = False) -> bytes:
    """IPv4 and TCP, as far as the relay reads it."""
    address = bytes(map(int, relay.address[dst].split(".")))
    ip = bytes([0x45]) + bytes(8) + bytes([6]) + bytes(6) + address
    return (ip + bytes(2) + (40000).to_bytes(2, "big") + bytes(9) + bytes([0x12 if syn else 0x10])).ljust(length, b"\0")


def test_a_host_sends_at_its_rate_and_its_queue_drops_at_the_end():
    relay = Relay(["a", "b", "c"], {"a", "b", "c"})
    relay.links = Links(rate_bit_s=64_000, queue_bytes=5_000, delay_s=2.0)
    burst = [relay.fate("a", packet(relay, dst, 1000), AT_S) for dst in ("b", "c") * 4]
    assert [at_s - AT_S for found in burst for at_s, _ in found] == pytest.approx([2.125, 2.25, 2.375, 2.5, 2.625])
    assert relay.count["full"] == 3
    assert relay.bytes == {"sent": 8_000, "arrived": 5_000}
    assert relay.fate("b", packet(relay, "c", 1000), AT_S) == [(pytest.approx(AT_S + 2.125), "c")]  # has its own queue
    assert relay.fate("a", packet(relay, "b", 1000), AT_S + 9) == [(pytest.approx(AT_S + 11.125), "b")]  # it is empty


@pytest.mark.parametrize(("burst", "row"), [(5.0, 5.0), (0.0, 1 / 0.9)])
def test_losses_come_in_bursts_of_the_mean_length_and_are_the_share(burst, row):
    relay = Relay(["a", "b"], {"a", "b"})
    relay.links = Links(loss=0.1, burst=burst)
    fates = [not relay.fate("a", packet(relay, "b", 100), AT_S) for _ in range(100_000)]
    rows = [len(list(same)) for lost, same in groupby(fates) if lost]
    assert sum(fates) / len(fates) == pytest.approx(0.1, rel=0.1)
    assert sum(rows) / len(rows) == pytest.approx(row, rel=0.1)


def test_a_connection_is_counted_once_however_often_it_is_accepted():
    relay = Relay(["a", "b"], {"a", "b"})
    for syn in (True, True, False):
        relay.fate("a", packet(relay, "b", 60, syn), AT_S)
    assert relay.accepted == {("a", "b", 40000)}
