"""What a robot that swims says of itself, so that its neighbours keep clear of it. Times as in messages.py."""

from __future__ import annotations

from typing import Annotated

from msgspec import UNSET, Meta, UnsetType

from agent.core.messages import NUMBER, SCHEMA, SENT, Count, Id, Message, Symmetric, means


class Presence(Message, frozen=True, kw_only=True):
    """Where a robot that swims is and where it goes, to one neighbour, so that they keep clear of each other. One that
    is lost says where it may be, by a wide `cov`; one that has not found itself yet says nothing."""

    schema: Annotated[int, means(NUMBER)] = SCHEMA
    fleet: Annotated[Id, means("name of the fleet")]
    src: Annotated[Id, means("the robot that says it")]
    dst: Annotated[Id, means("the neighbour that it is said to")]
    incarnation: Annotated[Count, means("which start of the sender this is: Unix time of it, ns")]
    seq: Annotated[Count, means("counts the rounds in which the sender says where it is")]
    sent_ns: Annotated[Count, means(SENT)]
    t_ns: Annotated[Count, means("of place and velocity: ns, by the clock of whoever said it")]
    x_m: Annotated[float, means("m, world frame, of the body's centre")]
    y_m: Annotated[float, means("m, world frame")]
    yaw_rad: Annotated[float, means("rad, anticlockwise from x")]
    depth_m: Annotated[float, means("m below the surface")]
    cov: Annotated[
        Symmetric,
        means(
            "covariance of x, y and yaw, m and rad, by its own sensors alone and with what is wrong in all of its "
            "fixes alike: xx xy xp yy yp pp"
        ),
    ]
    v_x_m_s: Annotated[float, means("m/s, world frame")]
    v_y_m_s: Annotated[float, means("m/s, world frame")]
    rate_rad_s: Annotated[float, means("rad/s, of yaw, anticlockwise")]
    goal_x_m: Annotated[float, means("m, world frame: where it is told to be now")]
    goal_y_m: Annotated[float, means("m, world frame")]
    goal_yaw_rad: Annotated[float, means("rad: how it is told to look now")]
    behaviour: Annotated[str, Meta(max_length=16), means("what it does now: the kind in the fleet file")]
    target: Annotated[Id | UnsetType, means("what it follows or searches for; left out: neither")] = UNSET
    glance_until_ns: Annotated[
        Count, means("its camera is at landmarks until then, by its clock, and others look at the target; 0: it is not")
    ] = 0
