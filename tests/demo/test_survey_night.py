"""The fleet that surveys in the dark is the one that surveys by day, with lamps and a lower goal, in the same basin."""

from msgspec.structs import replace

from agent.process.command import fleet_file
from agent.robot.fleet_reader import load_fleet
from hw.twin.scene import load_scene


def test_the_fleet_is_survey_but_for_its_lamps_and_what_it_asks_for() -> None:
    day, night = (load_fleet(fleet_file(name)) for name in ("survey", "survey_night"))
    assert night.lighting is not None and all(robot.lamp for robot in night.robot.values())
    robots = {name: replace(robot, lamp=False, listen=day.robot[name].listen) for name, robot in night.robot.items()}
    twin = replace(night.twin, scene=day.twin.scene)
    assert replace(night, fleet=day.fleet, lighting=None, coverage=day.coverage, robot=robots, twin=twin) == day
    assert night.coverage == replace(day.coverage, share=night.coverage.share)


def test_the_scene_is_the_same_basin_dark_in_the_water_that_the_fleet_file_states() -> None:
    day, night = load_scene("survey"), load_scene("survey_night")
    fleet = load_fleet(fleet_file("survey_night"))
    assert night.room_light == 0.0 and fleet.lighting is not None
    assert night.water.absorption_per_m == fleet.lighting.water.absorption_per_m
    assert night.water.scattering_per_m == fleet.lighting.water.scattering_per_m
    assert replace(night, name=day.name, room_light=day.room_light, water=day.water) == day
