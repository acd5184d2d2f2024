"""The fleet that lends light and the one that does not differ in where they look first, and in nothing else."""

from msgspec.structs import replace

from agent.process.command import fleet_file
from agent.robot.fleet_reader import load_fleet


def test_night_alone_is_night_but_for_the_lending_and_cameras_that_point_at_the_ball() -> None:
    night, alone = (load_fleet(fleet_file(name)) for name in ("night", "night_alone"))
    assert night.lighting is not None and alone.lighting is not None
    assert alone.lighting.gain > 1e6
    robots = {
        name: replace(robot, listen=night.robot[name].listen, look=night.robot[name].look)
        for name, robot in alone.robot.items()
    }
    assert all(robot.look.pan_deg == 0.0 for robot in alone.robot.values())
    lighting = replace(alone.lighting, gain=night.lighting.gain)
    assert replace(alone, fleet=night.fleet, lighting=lighting, robot=robots) == night
