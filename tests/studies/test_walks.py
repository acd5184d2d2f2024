"""Walks enter what they must, and not what is entered anyway."""

import inspect
from collections.abc import Callable

import pytest

pytest.importorskip("websockets", reason="the extra `page` is not installed")

from agent.core.attitude import AttitudeLog
from agent.core.estimation.evidence import Evidence
from agent.core.estimation.protocols import Metropolis
from agent.core.status import Status
from agent.process.agent_process import Runtime
from agent.robot.fleet_reader import load_fleet
from agent.robot.operator import Operator
from agent.robot.step import Agent
from hw.firmware.frames import Framer
from hw.stm32.driver import Stm32
from hw.stm32.protocol import HostProtocol
from tests.places import ROOT
from tests.studies.entered import Entered
from tests.studies.walks import byte_to_state, value_to_use


def place(function: Callable) -> str:
    """The file in which it stands, from the root."""
    return inspect.getfile(function).removeprefix(f"{ROOT}/")


@pytest.fixture(scope="module")
def value() -> Entered:
    value_to_use(entered := Entered())
    return entered


@pytest.fixture(scope="module")
def byte() -> Entered:
    byte_to_state(entered := Entered())
    return entered


def test_a_value_goes_from_its_reader_to_the_protocol_that_it_chooses(value: Entered) -> None:
    assert value.files[0] == place(load_fleet)
    for function in (load_fleet, Metropolis.tick, Agent.step):
        assert value.passes(function) and place(function) in value.files
    assert value.files.index(place(load_fleet)) < value.files.index(place(Metropolis.tick))


def test_what_a_step_does_without_the_value_is_not_on_its_walk(value: Entered) -> None:
    for function in (Evidence.tick, Operator.take, AttitudeLog.add):
        assert not value.passes(function) and place(function) not in value.files


def test_a_byte_goes_through_the_drivers_thread_and_the_loop(byte: Entered) -> None:
    for function in (HostProtocol.receive, Framer.feed, AttitudeLog.add, Status.state):
        assert byte.passes(function)
    for handed_on in (Stm32._run, Runtime.step, Agent.step):
        assert byte.passes(handed_on)
    assert not byte.passes(Stm32.send) and not byte.passes(Operator.take)


def test_files_are_the_products_alone_and_each_is_named_once(byte: Entered, value: Entered) -> None:
    for files in (byte.files, value.files):
        assert len(set(files)) == len(files)
        assert all((ROOT / file).is_file() and not file.startswith("tests/") for file in files)
