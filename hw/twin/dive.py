"""A dive of the whole fleet, tick by tick: the robots move as the boards command, and the boards read the new water.

Events are applied here too: those of the scene file at their times, or one that a test calls for.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from typing import Literal, NamedTuple, assert_never

import numpy as np
from numpy.typing import ArrayLike, NDArray

from agent.clock import machine
from agent.clock.clock import REST_NS, SERIAL, part_name
from agent.clock.keeper import Keeper
from agent.core.config import ConfigError, Fleet
from agent.core.messages import Vector
from hw.camera.camera import CameraGone
from hw.twin.board import PATIENCE_S, Act, Board, SensorFaults
from hw.twin.creatures import Attitude, Lookout, School, check_creatures
from hw.twin.physics.body import (
    BODY,
    OPEN_V,
    Escs,
    Lamps,
    cast_off,
    current_a,
    draw_body,
    matrix,
    quaternion,
    supply_v,
    thrust_loss,
)
from hw.twin.physics.sensors import PA_PER_M, BatteryProbes, PressureSensors, add_waves, water_pressure_pa
from hw.twin.physics.tank import STATE, STEP_S, TICK_NS, Flow, Gyros, Plant, advance, push, set_body
from hw.twin.scene import (
    AnyEvent,
    Battery,
    CastOff,
    Crossed,
    CurrentSet,
    FirmwareHang,
    GyroDead,
    GyroStuck,
    KillSwitch,
    Leak,
    Occlude,
    PowerCut,
    Pull,
    Push,
    Scene,
    SensorDead,
    SensorOffset,
    SensorStuck,
    SensorWell,
    SerialUnplug,
    SlowBoard,
    Startle,
    StartSigma,
    TagLost,
    TetherPull,
    ThrusterDead,
    ThrusterGain,
    check,
    put_off,
)
from hw.twin.truth import WATCH_TICKS, Stage, Watch, movable, true_tags

# --- dive ---

STILL = Scene(name="still")
STEP_US, TICK_US = round(STEP_S * 1e6), TICK_NS // 1000


def playable(fleet: Fleet, scene: Scene, robots: Sequence[str]) -> None:
    """Raise ConfigError for a target, a creature or an event of the scene that these robots' dive cannot have."""
    water_m = (*fleet.tank.size_m[:2], fleet.tank.surface_m)
    for k, solid in enumerate(scene.solid):
        is_target = solid.kind == "ball" or solid.name in fleet.target
        if is_target and not all(0.0 < x < m for x, m in zip(solid.position_m, water_m, strict=True)):
            raise ConfigError(
                f"scene '{scene.name}': key 'solid[{k}].position_m': {list(solid.position_m)} is outside of the water, "
                f"{' x '.join(f'{m:g}' for m in water_m)} m; write metres"
            )
    check_creatures(scene.creature, water_m)
    tags = [tag.id for tag in fleet.landmarks.tag] if fleet.landmarks else []
    check(scene.event, robots, movable(fleet, scene), tags, [creature.name for creature in scene.creature])


class Dive:
    """All robots of a fleet in one tank, and its clock: start_ns + ticks * 10 ms.

    `plants` overrides what is drawn for the robots that it names. Raises ConfigError for a scene that is not
    `playable`.
    """

    def __init__(
        self,
        fleet: Fleet,
        robots: Sequence[str],
        start_ns: int,
        *,
        plants: Mapping[str, Plant] | None = None,
        scene: Scene = STILL,
    ) -> None:
        playable(fleet, scene, robots)
        seed, surface_m = fleet.twin.seed, fleet.tank.surface_m
        self.robots = list(robots)
        rows = [(plants or {}).get(name, Plant()) for name in robots]
        self.bodies, self.states = launch(fleet, robots, rows, scene.start_sigma)
        self._tank, self._waves = fleet.tank, scene.waves
        self.sensors = PressureSensors(seed, self.robots, [p.noise_m for p in rows], [p.late_samples for p in rows])
        self.tare_pa = self.sensors.tare_pa()
        self.gyros = Gyros(seed, self.robots, fleet.navigation is not None and fleet.navigation.gyro)
        self.sensor_faults = SensorFaults(len(robots))
        self.battery_v = np.full(len(robots), OPEN_V)  # without load
        self._probes = BatteryProbes(seed, self.robots)
        self.lamps = Lamps(seed, self.robots)
        self.escs = Escs(len(robots))
        self.boards: list[Board] = []
        self.answered_s = [0.0] * len(robots)  # how long, on the wall, the last tick waited for each firmware
        self.history = History(len(robots), start_ns, len(scene.creature))
        self.stage = Stage(scene.solid, true_tags(fleet.landmarks, seed))
        self.school = School(scene.creature, seed, (*fleet.tank.size_m[:2], surface_m), scene.solid)
        self.watch: Watch | None = None  # of robots that swim, where their paths are to be recorded
        self.lookout: Lookout | None = None  # the same of creatures
        self.ticks, self._start_ns = 0, start_ns
        self._mounting, self._size_m, self._surface_m = fleet.body, np.array(fleet.tank.size_m), surface_m
        self._flow = Flow(seed, self.robots, scene.current, scene.tether_pull)
        self._pulses_us = np.zeros((len(robots), 8))  # no pulses before a board drives its pins
        self._wired = np.tile(np.arange(8), (len(robots), 1))  # the pin that each thruster hangs on
        self._to_show: list[tuple[int, int, Act]] = []  # pins to come: since when in us, number of the robot
        self._nominal_deg = np.zeros((len(robots), 4))
        self._water_pa = np.zeros((len(robots), 4))
        self._to_come = sorted(scene.event, key=lambda event: event.at_s, reverse=True)  # the next is the last
        for name in () if scene.moored else robots:
            self.cast_off(name)
        self._measure()

    @property
    def now_ns(self) -> int:
        return self._start_ns + self.ticks * TICK_NS

    def tick(self, patience_s: float) -> None:
        """Take the answers to the last tick, move on by 10 ms, and send the next tick.

        The 10 ms begin at the tick that was answered, in lock-step as at the wall clock; within them the pins change
        when the board has come so far, and the thrusters with the next of its pulses.
        """
        for i, board in enumerate(self.boards):
            asked_s = machine.monotonic_s()
            act = board.act(patience_s)
            self.answered_s[i] = machine.monotonic_s() - asked_s
            if act is not None:
                self._actuate(i, act)
            elif not board.driving:
                self._pulses_us[i] = 0.0
                self.lamps.asked[i] = 0.0
                self._to_show = [row for row in self._to_show if row[1] != i]
        while self._to_come and self._to_come[-1].at_s * 1e9 <= self.ticks * TICK_NS:
            apply(self._to_come.pop(), self)
        self.move()
        for i, board in enumerate(self.boards):
            board.tick(
                self.ticks * TICK_NS // 1000,
                self._readings_pa[i],
                self.sensor_faults.answered[i],
                self._battery_mv[i],
                round(self._drawn_a[i] * 100),
                self.sensor_faults.leak[i],
                self._rates_cdeg_s[i],
                self.escs.open[i],
                self._gravity_mg[i],
            )

    def move(self) -> None:
        """Physics and sensors alone."""
        now_us = self.ticks * TICK_US
        until_us = now_us + TICK_US
        self.escs.tick(self._pulses_us, self.supply_v, TICK_NS * 1e-9)
        if self._flow.active:
            self._flow.tick(self.states)
        for row in sorted((row for row in self._to_show if row[0] < until_us), key=lambda row: row[:2]):
            now_us = self._advance(now_us, row[0])
            self._show(row[1], row[2])
            self._to_show.remove(row)
        self._advance(now_us, until_us)
        self.lamps.tick(self.battery_v, TICK_NS * 1e-9)
        self.ticks += 1
        if self.school:
            self.school.tick(self.states["position_m"], self.stage.solids(self.now_ns), self._flow.velocity_m_s)
        self._measure()

    def _advance(self, now_us: int, until_us: int) -> int:
        """Let the water move, the last step shorter than the others if need be; returns what time it is then."""
        whole, rest_us = divmod(max(until_us - now_us, 0), STEP_US)
        for dt_s, steps in ((STEP_S, whole), (rest_us * 1e-6, 1 if rest_us else 0)):
            if steps:
                driven_us = self.escs.driven_us(self._pulses_us)
                wet = (self.bodies, self.states, driven_us, self._nominal_deg, self._size_m, self._surface_m)
                advance(*wet, dt_s, steps)
        return max(now_us, until_us)

    def _measure(self) -> None:
        t_s = self.ticks * TICK_NS * 1e-9
        self.history.append(self.states, self.school.attitudes, self.lamps.output)
        if self.ticks % WATCH_TICKS == 0:
            if self.watch is not None:
                self.watch.see(self.states, self.now_ns)
            if self.lookout is not None:
                self.lookout.see(self.school.attitudes, self.now_ns)
        water_pressure_pa(self.bodies, self.states, self._surface_m, self._water_pa)
        if self._waves.amplitude_m:
            add_waves(self._waves, self._size_m[0], self._surface_m, t_s, self.bodies, self.states, self._water_pa)
        self._readings_pa = self.sensor_faults.corrupt(self.sensors.sample(self._water_pa, t_s)).tolist()
        self._rates_cdeg_s = self.gyros.read(self.states["rates_rad_s"])
        self._gravity_mg = self.gyros.gravity_mg(self.states)
        drawn_a = current_a(self.states["thrust_n"]) + self.lamps.current_a
        supply = supply_v(self.battery_v, drawn_a)
        self.states["thrust_loss"] = thrust_loss(supply)
        self._drawn_a, self.supply_v = drawn_a.tolist(), supply
        self._battery_mv = self._probes.read_mv(supply)

    def _actuate(self, i: int, act: Act) -> None:
        self._to_show.append((act.since_us, i, act))
        if act.armed:
            self.states[i]["held"] = 0  # the crew lets the robot go, once

    def _show(self, i: int, act: Act) -> None:
        self._pulses_us[i] = np.take(act.pulses_us, self._wired[i])
        self.lamps.asked[i] = act.lamp_permille / 1000
        for k, servo_us in enumerate(act.servos_us):
            if servo_us:  # a servo without pulses stays where it is
                centred_us = servo_us - self._mounting.servo_centre_us
                self._nominal_deg[i, k] = centred_us / self._mounting.servo_us_per_deg

    def push(self, robot: str, force_n: Vector, point_m: Vector, for_s: float) -> None:
        """Push a robot: world-frame force at a body-frame point."""
        push(self.states[self._index(robot)], force_n, point_m, for_s)

    def kill_sensor(self, robot: str, sensor: int) -> None:
        """Pressure sensor 1 to 4 does not answer any more."""
        self.sensor_faults.kill(self._index(robot), sensor)

    def stick_sensor(self, robot: str, sensor: int) -> None:
        """The sensor repeats its last reading."""
        self.sensor_faults.stick(self._index(robot), sensor)

    def shift_sensor(self, robot: str, sensor: int, offset_m: float) -> None:
        """The sensor reads so much too deep."""
        self.sensor_faults.shift(self._index(robot), sensor, offset_m * PA_PER_M)

    def mend_sensor(self, robot: str, sensor: int) -> None:
        """The sensor is well again."""
        self.sensor_faults.mend(self._index(robot), sensor)

    def leak(self, robot: str) -> None:
        """Water at the probe in the hull."""
        self.sensor_faults.leak[self._index(robot)] = True

    def set_battery(self, robot: str, volts: float) -> None:
        """Open-circuit voltage of the pack."""
        self.battery_v[self._index(robot)] = volts

    def scale_thruster(self, robot: str, thruster: int, gain: float) -> None:
        """Thruster 1 to 8 gives so many times what it gave; 0: dead."""
        self.bodies[self._index(robot)]["thrust_gain"][thruster - 1] *= gain

    def turn_kill_switch(self, robot: str, to: Literal["open", "closed", "broken"]) -> None:
        """Open it: its thrusters have no pulses, whatever the firmware does. A broken wire stays open."""
        self.escs.turn(self._index(robot), to)

    def cross_thrusters(self, robot: str, first: int, second: int) -> None:
        """Two of thrusters 1 to 8 hang on each other's pins."""
        wired = self._wired[self._index(robot)]
        wired[[first - 1, second - 1]] = wired[[second - 1, first - 1]]

    def cross_sensors(self, robot: str, first: int, second: int) -> None:
        """Two of pressure sensors 1 to 4 hang on each other's channels, each with its own tare."""
        i = self._index(robot)
        self.sensor_faults.cross(i, first, second)
        self.tare_pa[i, [first - 1, second - 1]] = self.tare_pa[i, [second - 1, first - 1]]

    def unplug(self, robot: str, for_s: float) -> None:
        """Pull the serial cable."""
        self.boards[self._index(robot)].unplug(round(for_s * 1e6))

    def cut_power(self, robot: str, for_s: float) -> None:
        """Take the power from board and thrusters."""
        self.boards[self._index(robot)].cut_power(round(for_s * 1e6))
        self.escs.lose_power(self._index(robot))

    def hang_firmware(self, robot: str) -> None:
        """Stop its process, until the watchdog resets it."""
        self.boards[self._index(robot)].hang()

    def slow_board(self, robot: str, by: float) -> None:
        """Let the control module take so many times as long for everything."""
        self.boards[self._index(robot)].slow_down(by)

    def cast_off(self, robot: str) -> None:
        """Take the mooring off a robot: it swims."""
        i = self._index(robot)
        cast_off(self.bodies[i], self._tank)
        self.states["stirred"][i] = 1

    def pull_tether(self, robot: str, force_n: float, correlation_s: float, for_s: float) -> None:
        """Tug at a tether at random, force_n in the root of the mean square."""
        self._flow.pull(self._index(robot), Pull(force_n=force_n, correlation_s=correlation_s), for_s)

    def set_current(self, velocity_m_s: Vector) -> None:
        """Another current, which the water takes up within seconds."""
        self._flow.set_current(velocity_m_s)

    def move_solid(self, solid: int, to_m: Vector, over_s: float) -> None:
        """Move a solid of the scene from where it is."""
        self.stage.move(solid, to_m, self.now_ns, over_s)

    def lose_tag(self, number: int) -> None:
        """Take a tag away."""
        self.stage.lose_tag(number, self.now_ns)

    def _index(self, robot: str) -> int:
        return self.robots.index(robot)


def apply(event: AnyEvent, dive: Dive) -> None:
    """Make an event happen now, whatever its time."""
    match event:
        case Push():
            dive.push(event.robot, event.force_n, event.point_m, event.for_s)
        case SensorDead():
            dive.kill_sensor(event.robot, event.sensor)
        case SensorStuck():
            dive.stick_sensor(event.robot, event.sensor)
        case SensorOffset():
            dive.shift_sensor(event.robot, event.sensor, event.offset_m)
        case Crossed(what="sensors"):
            dive.cross_sensors(event.robot, *event.pair)
        case Crossed():
            dive.cross_thrusters(event.robot, *event.pair)
        case SensorWell():
            dive.mend_sensor(event.robot, event.sensor)
        case GyroDead() | GyroStuck():
            dive.gyros.fail(event.robot, stuck=isinstance(event, GyroStuck))
        case Leak():
            dive.leak(event.robot)
        case Battery():
            dive.set_battery(event.robot, event.volts)
        case ThrusterDead():
            dive.scale_thruster(event.robot, event.thruster, 0.0)
        case ThrusterGain():
            dive.scale_thruster(event.robot, event.thruster, event.gain)
        case KillSwitch():
            dive.turn_kill_switch(event.robot, event.to)
        case SerialUnplug():
            dive.unplug(event.robot, event.for_s)
        case PowerCut():
            dive.cut_power(event.robot, event.for_s)
        case FirmwareHang():
            dive.hang_firmware(event.robot)
        case SlowBoard():
            dive.slow_board(event.robot, event.by)
        case TetherPull():
            dive.pull_tether(event.robot, event.force_n, event.correlation_s, event.for_s)
        case CastOff():
            dive.cast_off(event.robot)
        case CurrentSet():
            dive.set_current(event.velocity_m_s)
        case Occlude():
            dive.move_solid(event.solid, event.to_m, event.over_s)
        case TagLost():
            dive.lose_tag(event.id)
        case Startle():
            dive.school.startle(event.creature, event.speed_m_s, event.for_s)
        case _:
            assert_never(event)


# --- launch ---


def launch(
    fleet: Fleet, robots: Sequence[str], plants: Sequence[Plant], sigma: StartSigma
) -> tuple[NDArray[np.void], NDArray[np.void]]:
    """(n,) BODY and (n,) STATE of the robots at the start of a dive.

    Bodies are drawn, each with what its plant overrides, put where the crew really puts them, and held until they are
    armed.
    """
    bodies, states = np.zeros(len(robots), BODY), np.zeros(len(robots), STATE)
    for i, name in enumerate(robots):
        pose, depth_m = fleet.robot[name].pose, fleet.robot[name].depth_m
        x_m, y_m, yaw_deg = put_off(sigma, (pose.x_m, pose.y_m, pose.yaw_deg), fleet.twin.seed, name)
        start = (x_m, y_m, fleet.tank.surface_m - depth_m, yaw_deg)
        bodies[i] = draw_body(fleet.twin.seed, name, start, fleet.tank, fleet.body)
        set_body(bodies[i], plants[i])
    states["held"] = 1
    states["position_m"] = bodies["home_m"]
    states["quaternion"] = [quaternion(0.0, 0.0, yaw) for yaw in bodies["home_yaw_rad"]]
    states["motor_deg"] = states["shaft_deg"] = bodies["servo_zero_deg"]
    return bodies, states


# --- history ---

SPAN = 200  # ticks kept


class RobotPose(NamedTuple):
    position_m: NDArray[np.float64]  # (3,) centre of the hull, world
    rotation: NDArray[np.float64]  # (3, 3) body -> world
    pan_deg: float  # where the camera's gimbal truly points
    tilt_deg: float
    lamp_pan_deg: float = 0.0
    lamp_tilt_deg: float = 0.0
    lamp: float = 0.0  # its light, as a share of a mean lamp's at full power


class History:
    """Where robots and creatures were during the last two seconds, for cameras that expose at a time of their own.

    A ring of the states at each tick. One thread appends; any number of threads wait and look.
    """

    def __init__(self, robots: int, start_ns: int, creatures: int = 0) -> None:
        self._rows = np.zeros((SPAN, robots, 12))  # position, quaternion, pan and tilt of camera and lamp, light
        self._swum = np.zeros((SPAN, creatures, len(Attitude._fields)))
        self._start_ns = start_ns
        self._newest = -1
        self._closed = False
        self._changed = threading.Condition()
        self._awaited_ns: float = np.inf  # earliest time that a thread waits for: no wake-up before that

    def append(self, states: NDArray[np.void], creatures: Sequence[Attitude] = (), lamps: ArrayLike = 0.0) -> None:
        """The states one tick after those appended before; `lamps` (robots,): their light."""
        with self._changed:
            self._newest += 1
            row = self._rows[self._newest % SPAN]
            row[:, :3], row[:, 3:7], row[:, 7:11] = states["position_m"], states["quaternion"], states["shaft_deg"]
            row[:, 11] = lamps
            if creatures:
                self._swum[self._newest % SPAN] = creatures
            if self.newest_ns >= self._awaited_ns:
                self._awaited_ns = np.inf
                self._changed.notify_all()

    @property
    def newest_ns(self) -> int:
        return self._start_ns + self._newest * TICK_NS

    def wait(self, t_ns: int) -> None:
        """Return once the water has moved on to t_ns. Raises CameraGone when the twin ends before."""
        with self._changed:
            while self.newest_ns < t_ns and not self._closed:
                self._awaited_ns = min(self._awaited_ns, t_ns)
                self._changed.wait()
            if self._closed:
                raise CameraGone("the twin has ended; start it again")

    def at(self, t_ns: int) -> list[RobotPose]:
        """The pose of each robot at t_ns, interpolated between ticks.

        Raises CameraGone for a time that is not, or no longer, kept: the reader was stopped for too long.
        """
        # A tick turns a robot by a degree at most: the quaternions' mean is as good as the arc between them.
        rows = self._between(self._rows, t_ns)
        return [RobotPose(row[:3], matrix(row[3:7]), *row[7:].tolist()) for row in rows]

    def creatures_at(self, t_ns: int) -> list[Attitude]:
        """The attitude of each creature, as `at`."""
        return [Attitude(*row) for row in self._between(self._swum, t_ns).tolist()]

    def _between(self, kept: NDArray[np.float64], t_ns: int) -> NDArray[np.float64]:
        with self._changed:
            k, rest_ns = divmod(t_ns - self._start_ns, TICK_NS)
            oldest = max(self._newest - SPAN + 1, 0)
            if not oldest <= k < self._newest + (rest_ns == 0):
                raise CameraGone(f"no pose is kept of {t_ns} ns; ask again")
            before, after = kept[k % SPAN], kept[(k + (rest_ns > 0)) % SPAN]
            return np.asarray(before + (rest_ns / TICK_NS) * (after - before))

    def close(self) -> None:
        """End all waits, with CameraGone."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()


# --- pace: by a clock that agents follow, or as fast as every firmware answers ---

LOCK_STEP_S = 5.0  # in virtual time a firmware that is silent for longer is taken for dead
UNREAD_NS = 25_000_000  # how long bytes may lie at the agent's end of a cable before time waits for their reader


def run_by_clock(dive: Dive, keeper: Keeper, stop: threading.Event) -> None:
    """Tick as the keeper lets time go, until stopped."""
    for board in dive.boards:
        reader = part_name(board.robot, SERIAL)
        keeper.limits[f"{board.robot}.port"] = PortLimit(reader, board, dive, keeper)
    while not stop.is_set():
        keeper.advance(dive.now_ns + TICK_NS, stop)
        dive.tick(PATIENCE_S)
        keeper.busy_s = {f"{board.robot}.firmware": s for board, s in zip(dive.boards, dive.answered_s, strict=True)}


class PortLimit:
    """How far time may go before an agent has taken what lies at its end of the cable; without an agent, anywhere."""

    def __init__(self, part: str, board: Board, dive: Dive, keeper: Keeper) -> None:
        self._part, self._board, self._dive, self._keeper = part, board, dive, keeper
        self._empty_ns = dive.now_ns

    def __call__(self) -> int:
        if not self._keeper.takes_part(self._part):
            return REST_NS
        if not self._board.unread():
            self._empty_ns = self._dive.now_ns
        return self._empty_ns + UNREAD_NS


def run_in_lock_step(dive: Dive, ticks: int) -> None:
    """Tick as fast as every firmware answers, for experiments. Raises TimeoutError naming one that does not."""
    for _ in range(ticks):
        dive.tick(LOCK_STEP_S)
        for board in dive.boards:
            if board.overdue:
                raise TimeoutError(f"the firmware of {board.robot} did not answer for {LOCK_STEP_S} s")
