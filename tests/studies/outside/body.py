"""The twin's body in water before MuJoCo and AUVSimBench; the board's control law on MuJoCo's body.

Like for like, a judge has the mass, added mass and drag that the twin drew, in equations of its own. On MuJoCo's own
plant its ellipsoid model finds added mass and drag by itself, of the hull's semi-axes alone.
"""

from __future__ import annotations

import math
from importlib.metadata import version
from typing import Any

import mujoco
import numpy as np
from auv_sim_bench.dynamics import AUVDynamics, AUVParams
from numpy.typing import NDArray

from agent.core.config import Body, Fleet
from agent.experiments import orientation
from agent.experiments.ball_measurements import hosts_of
from hw.twin.dive import Dive
from hw.twin.physics.body import (
    ADDED_KG,
    HULL_M,
    QUADRATIC_DRAG,
    draw_body,
    euler_rad,
    lagged_thrust_n,
    matrix,
    quaternion,
    static_thrust_n,
)
from hw.twin.physics.forces import GRAVITY_M_S2, TETHER_WEIGHT_N, WATER_KG_M3, add_force, add_lines, add_thrust
from hw.twin.physics.sensors import CORNERS
from hw.twin.physics.tank import STATE, STEP_S, Plant, advance, push
from tests.studies.outside.finding import Finding

MUJOCO, AUVSIM = f"MuJoCo {version('mujoco')}", f"AUVSimBench {version('auv_sim_bench')}"
DEEP_M = 50.0  # so far from the walls of a tank of twice that size that nothing is touched
Array = NDArray[np.float64]


def loose_body(seed: int) -> NDArray[np.void]:
    """A record () BODY without lines."""
    body = draw_body(seed, "r1", (DEEP_M, DEEP_M, DEEP_M, 0.0), orientation.tank(0).tank, Body())
    body["mooring"], body["tether_m"] = 0.0, 1e9
    return body


# --- bodies: each moves on by a step, pushed by a wrench in the world's frame ---


class Twin:
    """The twin's own equations."""

    def __init__(self, body: NDArray[np.void], roll_deg: float, surge_m_s: float) -> None:
        self.bodies, self.states = body.reshape(1), np.zeros(1, STATE)
        self.states["position_m"] = DEEP_M
        self.states["quaternion"] = quaternion(math.radians(roll_deg), 0.0, 0.0)
        self.states["velocity_m_s"][:, 0] = surge_m_s

    def step(self, force_n: Array, point_m: Array) -> None:
        push(self.states[0], tuple(force_n), tuple(point_m), STEP_S)
        size_m = np.full(3, 2 * DEEP_M)
        advance(self.bodies, self.states, np.zeros((1, 8)), np.zeros((1, 4)), size_m, 2 * DEEP_M, STEP_S, 1)

    def seen(self) -> tuple[float, ...]:
        """x_m, z_m, roll_deg, forward m/s, upward m/s."""
        s = self.states[0]
        x, _, z = s["position_m"] - DEEP_M
        v = matrix(s["quaternion"]) @ s["velocity_m_s"]
        return x, z, math.degrees(euler_rad(s["quaternion"])[0]), v[0], v[2]


class Bench:
    """AUVSimBench has one mass for all directions, and no added mass: it gets that of the axis which moves."""

    def __init__(self, body: NDArray[np.void], roll_deg: float, surge_m_s: float, axis: int) -> None:
        p = AUVParams()
        added = float(body["added_kg"][axis])
        lift_n = float(body["displaced_kg"]) * GRAVITY_M_S2 - TETHER_WEIGHT_N + added * GRAVITY_M_S2
        p.mass, p.water_density, p.gravity = float(body["mass_kg"]) + added, WATER_KG_M3, GRAVITY_M_S2
        p.volume = lift_n / (WATER_KG_M3 * GRAVITY_M_S2)  # the net weight stays
        arm_m = float(body["buoyancy_arm_m"]) * float(body["displaced_kg"]) * GRAVITY_M_S2 / lift_n
        p.cob_offset = np.array([0.0, 0.0, arm_m])  # and so does what rights it
        p.inertia = body["inertia_kgm2"] + body["added_inertia_kgm2"]
        p.lin_drag, p.ang_drag = body["linear_drag"][:3], body["linear_drag"][3:]
        p.quad_drag, p.ang_quad_drag = body["quadratic_drag"][:3], body["quadratic_drag"][3:]
        self.dynamics = AUVDynamics(p)
        self.dynamics.s.q = np.array(quaternion(math.radians(roll_deg), 0.0, 0.0))
        self.dynamics.s.v = np.array([surge_m_s, 0.0, 0.0])

    def step(self, force_n: Array, point_m: Array) -> None:
        force = matrix(self.dynamics.s.q).T @ force_n
        self.dynamics.step(STEP_S, force, np.cross(point_m, force))

    def seen(self) -> tuple[float, ...]:
        s = self.dynamics.s
        v = matrix(s.q) @ s.v
        return s.p[0], s.p[2], math.degrees(euler_rad(s.q)[0]), v[0], v[2]


class Mujoco:
    """A free body with MuJoCo's ellipsoid model of fluids: `own`, or with the twin's added mass and drag.

    MuJoCo leaves the part of added mass that resists acceleration out; it stands as armature of the free joint, whose
    three translations are the world's: exact for a body that is near level and does not turn about z.
    """

    def __init__(
        self, body: NDArray[np.void], roll_deg: float, surge_m_s: float, own: bool = False, drag_scale: float = 1.0
    ) -> None:
        size, inertia = " ".join(map(str, HULL_M)), " ".join(map(str, body["inertia_kgm2"]))
        self.model = mujoco.MjModel.from_xml_string(f"""<mujoco>
            <option timestep="{STEP_S}" density="{WATER_KG_M3}" integrator="implicitfast"
              gravity="0 0 -{GRAVITY_M_S2}"/>
            <worldbody><body><freejoint/><inertial pos="0 0 0" mass="{body["mass_kg"]}" diaginertia="{inertia}"/>
            <geom type="ellipsoid" size="{size}" contype="0" conaffinity="0" fluidshape="ellipsoid"/>
            </body></worldbody></mujoco>""")
        self.data = mujoco.MjData(self.model)
        self.body, fluid = body, self.model.geom_fluid[0]
        if not own:
            fluid[6:9], fluid[9:12] = body["added_kg"] / WATER_KG_M3, body["added_inertia_kgm2"] / WATER_KG_M3
            self.model.dof_damping[:] = body["linear_drag"]
            self.fit_drag(body["quadratic_drag"])
        fluid[1:4] *= drag_scale
        self.model.dof_armature[:] = fluid[6:12] * WATER_KG_M3  # MuJoCo keeps them for a density of one
        mujoco.mj_setConst(self.model, self.data)  # else a free body keeps the mass matrix that it was compiled with
        self.data.qpos[3:7] = quaternion(math.radians(roll_deg), 0.0, 0.0)
        self.data.qvel[0] = surge_m_s

    def fit_drag(self, wanted: Array) -> None:
        """Its three coefficients by surge, heave and roll; it has no more. Lift, which the twin lacks, is none."""
        fluid = self.model.geom_fluid[0]
        fluid[4:6] = 0.0
        columns = []
        for k in (1, 2, 3):
            fluid[1:4] = 0.0
            fluid[k] = 1.0
            columns.append(self.drag()[[0, 2, 3]])
        fluid[1:4] = np.linalg.solve(np.array(columns).T, wanted[[0, 2, 3]])

    def drag(self) -> Array:
        """(6,) of quadratic drag, N s2/m2 and N m s2, at one metre or radian a second."""
        found = []
        for axis in range(6):
            self.data.qvel[:] = 0.0
            self.data.qvel[axis] = 1.0
            mujoco.mj_forward(self.model, self.data)
            found.append(-self.data.qfrc_fluid[axis])
        self.data.qvel[:] = 0.0
        return np.array(found)

    def step(self, force_n: Array, point_m: Array) -> None:
        self.move(force_n, np.cross(self.turned() @ point_m, force_n), STEP_S)

    def move(self, force_n: Array, torque_nm: Array, dt_s: float) -> None:
        """World's frame; the lift of a hull that is under water is added here."""
        d = self.data
        lift = np.array([0.0, 0.0, float(self.body["displaced_kg"]) * GRAVITY_M_S2])
        arm = self.turned() @ np.array([0.0, 0.0, float(self.body["buoyancy_arm_m"])])
        d.xfrc_applied[1, :3] = force_n + lift - [0.0, 0.0, TETHER_WEIGHT_N]
        d.xfrc_applied[1, 3:] = torque_nm + np.cross(arm, lift)
        self.model.opt.timestep = dt_s
        mujoco.mj_step(self.model, d)

    def turned(self) -> Array:
        return np.asarray(matrix(self.data.qpos[3:7]))

    def seen(self) -> tuple[float, ...]:
        x, z = self.data.qpos[[0, 2]]
        return x, z, math.degrees(euler_rad(self.data.qpos[3:7])[0]), self.data.qvel[0], self.data.qvel[2]


# --- free motions ---

PUSH_N, PUSH_S, PUSH_AT_M = np.array([0.0, 0.0, -8.0]), 0.3, np.array([0.0, 0.13, 0.0])


def path(one: Any, seconds: float, pushed_s: float = 0.0) -> Array:
    """(n, 5) of `seen`."""
    rows = []
    for k in range(round(seconds / STEP_S)):
        one.step(PUSH_N if k * STEP_S < pushed_s else np.zeros(3), PUSH_AT_M)
        rows.append(one.seen())
    return np.array(rows)


def first_s(good: NDArray[np.bool_]) -> float:
    return STEP_S * (1 + int(np.argmax(good)))


MOTIONS = {  # start: roll in degrees, surge in m/s; seconds, pushed for, the axis that moves; what is compared
    "roll": (20.0, 0.0, 4.0, 0.0, 2),
    "surge": (0.0, 0.5, 3.0, 0.0, 0),
    "sink": (0.0, 0.0, 20.0, 0.0, 2),
    "push": (0.0, 0.0, 1.0, PUSH_S, 2),
}


def figures(motion: str, track: Array) -> dict[str, tuple[float, str]]:
    if motion == "roll":
        roll = track[:, 2]
        return {
            "roll let go at 20 deg: until it is level first": (first_s(roll < 0), "s"),
            "roll let go at 20 deg: its swing to the other side": (float(-roll.min()), "deg"),
        }
    if motion == "surge":
        return {
            "surge of 0.5 m/s: until it is halved": (first_s(track[:, 3] < 0.25), "s"),
            "surge of 0.5 m/s: way after 3 s": (1e3 * float(track[-1, 0]), "mm"),
        }
    if motion == "sink":
        return {"let go: speed down or up after 20 s": (1e3 * abs(float(track[-1, 4])), "mm/s")}
    return {
        "pushed by 8 N for 0.3 s at 0.13 m: largest roll in 1 s": (float(np.abs(track[:, 2]).max()), "deg"),
        "pushed by 8 N for 0.3 s at 0.13 m: way down in 1 s": (-1e3 * float(track[-1, 1]), "mm"),
    }


def free_motions(seed: int) -> list[Finding]:
    body, found = loose_body(seed), []
    for motion, (roll_deg, surge_m_s, seconds, pushed_s, axis) in MOTIONS.items():
        ours = figures(motion, path(Twin(body, roll_deg, surge_m_s), seconds, pushed_s))
        judges = {MUJOCO: Mujoco(body, roll_deg, surge_m_s), AUVSIM: Bench(body, roll_deg, surge_m_s, axis)}
        for judge, one in judges.items():
            theirs = figures(motion, path(one, seconds, pushed_s))
            found += [
                Finding(words, judge, value, theirs[words][0], unit, LIKE) for words, (value, unit) in ours.items()
            ]
    return found


LIKE = 0.05  # the same coefficients: what is left is the equations
WATER = 0.60  # how far the twin's spread of added mass and drag reaches (WATER_SPREAD)


def coefficients() -> list[Finding]:
    """The middles that the twin draws about, beside MuJoCo's for a solid ellipsoid of the hull's size."""
    own = Mujoco(loose_body(0), 0.0, 0.0, own=True)
    drag, added = own.drag(), own.model.dof_armature[:3]
    pairs = [
        (f"{what}, {axis}", mine[k], theirs[k], unit)
        for what, mine, theirs, unit in (
            ("added mass", ADDED_KG, added, "kg"),
            ("quadratic drag", QUADRATIC_DRAG, drag, "N s2/m2"),
        )
        for axis, k in (("surge", 0), ("heave", 2))
    ]
    return [Finding(words, MUJOCO, mine, float(theirs), unit, WATER) for words, mine, theirs, unit in pairs]


# --- the control law on MuJoCo's own plant ---


class MujocoDive(Dive):
    """A dive of one robot whose hull MuJoCo moves; thrusters, lines, sensors and board stay the twin's."""

    hull: Mujoco
    drag_scale = 1.0

    def _advance(self, now_us: int, until_us: int) -> int:
        body, s = self.bodies[0], self.states[0]
        left_us = max(until_us - now_us, 0)
        while left_us:
            dt_us = min(left_us, round(STEP_S * 1e6))
            left_us -= dt_us
            self._step(body, s, dt_us * 1e-6)
        return max(now_us, until_us)

    def _step(self, body: Any, s: Any, dt_s: float) -> None:
        pulses = self.escs.driven_us(self._pulses_us)[0]
        for k in range(8):
            gain = float(body["thrust_gain"][k]) * (1.0 - float(s["thrust_loss"]))
            target = static_thrust_n(pulses[k], body["neutral_us"][k], gain)
            s["thrust_n"][k] = lagged_thrust_n(s["thrust_n"][k], target, body["thrust_lag_s"][k], dt_s)
        if s["held"]:
            return
        if not hasattr(self, "hull"):
            self.hull = Mujoco(body.copy(), 0.0, 0.0, own=True, drag_scale=self.drag_scale)
            self.hull.data.qpos[:3], self.hull.data.qpos[3:7] = s["position_m"], s["quaternion"]
        q, R = tuple(s["quaternion"]), matrix(s["quaternion"])
        wrench, v = np.zeros(6), tuple(s["velocity_m_s"])
        add_thrust(body, s["thrust_n"], wrench)
        add_lines(body, tuple(s["position_m"]), q, tuple(R @ v), tuple(s["rates_rad_s"]), wrench)
        if s["push_s"] > 0:
            add_force(wrench, tuple(R.T @ s["push_n"]), tuple(s["push_at_m"]))
            s["push_s"] -= dt_s
        self.hull.move(R @ wrench[:3], R @ wrench[3:], dt_s)
        qpos, qvel = self.hull.data.qpos, self.hull.data.qvel
        s["position_m"], s["quaternion"], s["rates_rad_s"] = qpos[:3], qpos[3:7], qvel[3:]
        s["velocity_m_s"] = matrix(qpos[3:7]).T @ qvel[:3]


def flown(on: type[Dive], seed: int, manoeuvre: orientation.Manoeuvre, mass: float, drag: float) -> orientation.Track:
    """As orientation.respond, with the law that ships, on a plant whose mass and drag are scaled. Raises Failed where
    the robot does not arm."""
    fleet: Fleet = orientation.tank(seed)
    dive = on(fleet, ["r1"], 0, plants={"r1": Plant(mass_scale=mass, lag_s=0.10)})
    if isinstance(dive, MujocoDive):
        dive.drag_scale = drag
    else:
        for name in ("linear_drag", "quadratic_drag"):
            dive.bodies[name] *= drag
    dive.states["position_m"][:, 2] = fleet.tank.surface_m - manoeuvre.start_m
    with hosts_of(dive, {"law": orientation.LAWS[0]}) as hosts:
        corner = CORNERS[seed % len(CORNERS)]
        return orientation.carry_out(dive, hosts["r1"], manoeuvre, fleet.tank.surface_m, corner)


SCALES = ((1.0, 1.0), (0.7, 0.7), (0.7, 1.3), (1.3, 0.7), (1.3, 1.3))  # of mass, of drag
NEVER_S = orientation.LIMIT_S  # a robot that never comes to rest counts as this
SCORES = (
    ("recovery_s", "pushed at a corner, recovered, median", "s", 0.3),
    ("settle_s", "sent down by 0.19 m, at depth, median", "s", 0.3),
    ("hover_depth_rms_mm", "at rest, depth off, rms, median", "mm", 0.5),
    ("hover_tilt_rms_deg", "at rest, tilt, rms, median", "deg", 0.1),
)


def control(seeds: int) -> list[Finding]:
    """Twin and judge side by side; first the plant as it is, then with mass and drag 30 % off."""
    found: list[Finding] = []
    for mass, drag in SCALES:
        twin, judged = (
            [
                scored(*(flown(on, seed, manoeuvre, mass, drag) for manoeuvre in (orientation.PUSH, orientation.STEP)))
                for seed in range(seeds)
            ]
            for on in (Dive, MujocoDive)
        )
        plant = "the law on its body" if mass == drag == 1.0 else f"the same, mass x {mass:g}, drag x {drag:g}"
        for key, words, unit, allowed in SCORES[: None if mass == drag == 1.0 else 2]:
            found.append(
                Finding(f"{plant}: {words}", MUJOCO, _middle(twin, key), _middle(judged, key), unit, allowed, True)
            )
    return found


def _middle(of: list[dict[str, Any]], key: str) -> float:
    return float(np.median([NEVER_S if row[key] is None else row[key] for row in of]))


def scored(pushed: orientation.Track, sent: orientation.Track) -> dict[str, Any]:
    push_of, step_of = orientation.PUSH, orientation.STEP
    return orientation.score_push(pushed, push_of.goal_m, orientation.HOVER_S) | orientation.score_step(
        sent, step_of.start_m, step_of.goal_m
    )


def judge(quick: bool) -> list[Finding]:
    """Free motions of one drawn robot, coefficients, and the law on one robot, or on five."""
    return [*free_motions(1), *coefficients(), *control(1 if quick else 5)]
