"""Motors as people want them: what is ordered is told to the module, and told again, and nothing undoes it."""

import pytest

from hw.firmware import wire
from hw.firmware.failsafe import DISARM, HOLD, OK, SURFACE
from hw.stm32.driver import AGAIN_NS, Motors, surfacing_for_silence
from tests.sample_messages import telemetry

SILENT = {"armed": True, "ladder": SURFACE}


class Board:
    """What a module was told."""

    def __init__(self) -> None:
        self.told: list[str] = []
        self.wants_armed = True

    def arm(self) -> None:
        self.told.append("arm")

    def disarm(self) -> None:
        self.told.append("off")

    def surface(self) -> None:
        self.told.append("surface")


def feel(motors: Motors, seconds: float, **state) -> None:
    """Telemetry at every step for so long."""
    for step in range(round(seconds * 20)):
        now_ns = 10**12 + step * 50_000_000
        motors.feel((telemetry(now_ns, **state),), now_ns)


@pytest.mark.parametrize(
    ("arm", "ordered", "again"),
    [
        (True, None, "arm"),  # whoever started it with --arm wants the dive to go on
        (False, None, None),  # it was armed by somebody else, and is no business of ours
        (True, "surface", None),
        (True, "off", "off"),
        (False, "arm", "arm"),
    ],
)
def test_a_robot_that_rises_for_silence_is_called_back_only_where_it_is_wanted_down(arm, ordered, again) -> None:
    board = Board()
    motors = Motors(board, arm)
    if ordered is not None:
        motors.obey(ordered, 0)
    board.told.clear()
    feel(motors, 1.0, **SILENT)
    assert set(board.told) == ({again} if again else set())


def test_an_ordered_surfacing_lasts_to_its_end() -> None:
    board = Board()
    motors = Motors(board, True)
    motors.obey("surface", 0)
    feel(motors, 3.0, **SILENT)
    feel(motors, 3.0, armed=False, ladder=DISARM)
    assert board.told == ["surface"]
    motors.obey("arm", 10**13)
    assert board.told == ["surface", "arm"]


@pytest.mark.parametrize(("ordered", "ladder"), [("off", OK), ("surface", OK), ("surface", HOLD)])
def test_a_module_that_does_not_do_it_is_told_again(ordered: str, ladder: int) -> None:
    board = Board()
    motors = Motors(board, False)
    motors.obey(ordered, 10**12)
    feel(motors, 1.6, armed=True, ladder=ladder)
    assert board.told == [ordered] * (1 + int(1.55e9 / AGAIN_NS))


def test_what_the_module_has_given_up_is_a_fault_only_while_it_is_wanted() -> None:
    board = Board()
    board.wants_armed = False
    motors = Motors(board, True)
    assert "order: arm" in motors.fault()
    motors.obey("off", 0)
    assert motors.fault() is None
    assert Motors(board, False).fault() is None


@pytest.mark.parametrize("flag", [wire.FLAG_LEAK, wire.FLAG_BATTERY, wire.FLAG_DEGRADED])
def test_what_is_for_a_person_to_judge_is_no_silence(flag: int) -> None:
    assert surfacing_for_silence(telemetry(0, **SILENT))
    assert not surfacing_for_silence(telemetry(0, **SILENT, flags=flag))
    assert not surfacing_for_silence(telemetry(0, armed=False, ladder=SURFACE))
