"""A sweep as a state machine: which positions it visits, what it measures, what it rejects and how it goes on then."""

import itertools

import pytest
from msgspec.structs import replace

from agent.core.ranging.sweep import (
    LOST,
    TRACK_STEPS,
    LateFrames,
    Measurement,
    Rejected,
    Sweep,
    full_positions,
    home_position,
    short_of_infinity,
)
from agent.core.step_io import Sighting, Telemetry
from tests.known_lens import PLAIN

FIT = replace(PLAIN, u_inf_m=0.0, covariance=(0.0,) * 6, noise=1.0, lowest=200)
S = 1_000_000_000


def frames(sweep: Sweep, plan, peak: float, **changes):
    for index, lens_position in enumerate(plan.focus[1:], start=1):
        fields = dict(
            t_ns=index * 100,
            frame=index,
            sweep=plan.sweep,
            index=index,
            focus=lens_position,
            target="ball",
            found=True,
            centre_px=(320.0, 240.0),
            radius_px=150.0,
            clarity=10 + 90 / (1 + ((lens_position - peak) / 60) ** 2),
            area_px=1e4,
            score=1.0,
        )
        for key, value in changes.items():
            fields[key] = value(index) if callable(value) else value
        sweep.frame(Sighting(**fields))


def test_full_then_tracking_around_the_peak_stamped_with_the_sharpest_frame() -> None:
    sweep = Sweep(FIT, 30)
    plan = sweep.start(0)
    assert plan.focus[1:] == full_positions(FIT, 30)
    assert plan.focus[0] < plan.focus[1]
    assert sweep.finish(S) is None
    frames(sweep, plan, 431.0)
    result = sweep.finish(S)
    assert isinstance(result, Measurement)
    assert result.lens_position == pytest.approx(431.0, abs=1.0)
    nearest = min(range(1, 31), key=lambda k: abs(plan.focus[k] - 431))
    assert result.t_ns == nearest * 100
    track = sweep.start(2 * S)
    assert len(track.focus) == TRACK_STEPS + 1
    assert track.focus[1] < 431 < track.focus[-1]
    assert list(track.focus) == sorted(track.focus)
    frames(sweep, track, 440.0)
    result = sweep.finish(3 * S)
    assert isinstance(result, Measurement)
    assert result.lens_position == pytest.approx(440.0, abs=1.0)


def test_a_box_may_tremble_in_proportion_to_its_size() -> None:
    for width_px, kind in ((80.0, Rejected), (240.0, Measurement)):
        sweep = Sweep(FIT, 30)
        box = {"radius_px": None, "size_px": (width_px, 100.0), "centre_px": lambda k: (320.0 + 20.0 * (k % 2), 240.0)}
        frames(sweep, sweep.start(0), 431.0, **box)
        result = sweep.finish(S)
        assert isinstance(result, kind)
    assert result.outline.radius_px is None and result.outline.size_px == (240.0, 100.0)


def test_a_slow_sweep_is_waited_for_while_its_frames_come() -> None:
    sweep = Sweep(FIT, 30)
    plan = sweep.start(0)
    late = 20 * S  # a full sweep should take 6 s
    frames(sweep, plan, 431.0, t_ns=lambda k: k * late // 30, found=lambda k: k < 31)
    assert isinstance(sweep.finish(late), Measurement)
    plan = sweep.start(late)
    first = Sighting(t_ns=late, frame=1, sweep=plan.sweep, index=1, target="ball", found=False)
    sweep.frame(first)
    assert sweep.finish(late + S) is None
    result = sweep.finish(late + 10 * S)
    assert isinstance(result, Rejected) and "not finished in time" in result.reason


def test_rejections_and_return_to_a_full_sweep() -> None:
    sweep = Sweep(FIT, 30)
    frames(sweep, sweep.start(0), 431.0)
    assert isinstance(sweep.finish(S), Measurement)
    for _ in range(2):
        plan = sweep.start(S)
        assert len(plan.focus) == TRACK_STEPS + 1
        frames(sweep, plan, 431.0, centre_px=lambda k: (320.0 + 40 * k, 240.0))
        result = sweep.finish(2 * S)
        assert isinstance(result, Rejected)
        assert "moved" in result.reason
    plan = sweep.start(2 * S)
    assert len(plan.focus) == 16  # half of 30, since what moves will not wait for more
    frames(sweep, plan, 431.0, found=lambda k: k % 2 == 0)
    result = sweep.finish(3 * S)
    assert isinstance(result, Rejected)
    assert "seen in 7 of 15" in result.reason
    plan = sweep.start(3 * S)
    assert len(plan.focus) == 31  # that was not for motion
    frames(sweep, plan, 431.0)
    assert isinstance(sweep.finish(4 * S), Measurement)
    assert len(sweep.start(4 * S).focus) == TRACK_STEPS + 1


@pytest.mark.parametrize(("drift_px", "kind"), [(110.0, Measurement), (130.0, Rejected)])
@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("tracking", [False, True])
def test_a_slow_drift_adds_up_over_the_sweep(drift_px: float, kind: type, axis: int, tracking: bool) -> None:
    """Each frame is near enough to the one before, and yet the last may be too far from the first."""
    sweep = Sweep(FIT, 30)
    if tracking:
        frames(sweep, sweep.start(0), 431.0)
        assert isinstance(sweep.finish(S), Measurement)
    plan = sweep.start(S)
    each_px = drift_px / (len(plan.focus) - 2)
    there = (lambda k: (320.0 - each_px * k, 240.0)) if axis == 0 else (lambda k: (320.0, 240.0 + each_px * k))
    frames(sweep, plan, 431.0, centre_px=there)
    result = sweep.finish(2 * S)
    if tracking:  # the same drift in a quarter of the frames is too quick from frame to frame
        assert isinstance(result, Rejected) and "px between frames" in result.reason
        return
    assert isinstance(result, kind)
    assert kind is Measurement or "moved 130 px during the sweep" in result.reason


def test_a_drift_there_and_back_counts_too() -> None:
    sweep = Sweep(FIT, 30)
    plan = sweep.start(0)
    frames(sweep, plan, 431.0, centre_px=lambda k: (320.0 + 10.0 * min(k, 30 - k), 240.0))
    result = sweep.finish(S)
    assert isinstance(result, Rejected) and "moved 150 px during the sweep" in result.reason


def test_full_sweeps_of_what_moves_get_shorter_but_not_for_ever() -> None:
    sweep, steps = Sweep(FIT, 30), []
    for k in range(5):
        plan = sweep.start(10 * k * S)
        steps.append(len(plan.focus) - 1)
        assert plan.focus[1] < FIT.rho0 and plan.focus[-1] > FIT.highest
        frames(sweep, plan, 431.0, centre_px=lambda k: (320.0 + 11.0 * k, 240.0) if k < 14 else (600.0, 240.0))
        result = sweep.finish(10 * k * S + S)
        if len(plan.focus) <= 9:
            assert isinstance(result, Measurement)
            break
    assert steps == [30, 15, 8]
    assert len(sweep.start(99 * S).focus) == TRACK_STEPS + 1


def test_full_sweeps_that_keep_giving_nothing_leave_pauses() -> None:
    sweep, now, started = Sweep(FIT, 30), 0, []
    for _ in range(6):
        while not sweep.ready(now):
            now += S // 10
        started.append(now)
        plan = sweep.start(now)
        assert not sweep.ready(now)
        now += 3 * S
        frames(sweep, plan, 431.0, clarity=50.0)
        result = sweep.finish(now)
        assert isinstance(result, Rejected) and "flat" in result.reason
    assert [b - a for a, b in itertools.pairwise(started)] == [3 * S, 3 * S, 5 * S, 5 * S, 5 * S]
    sweep.forget()
    assert sweep.ready(now)


@pytest.mark.parametrize(
    ("lowest", "says"),
    [(0, None), (100, None), (160, "the lens stops at 160, infinity is at 100: no range to targets beyond 2.1 m")],
)
def test_a_lens_that_stops_before_infinity_is_spoken_of_once(lowest: int, says: str | None) -> None:
    sweep = Sweep(FIT, 30)
    for k in range(2):
        plan = sweep.start(k * S)
        frames(sweep, plan, 431.0, focus=lambda k, plan=plan: max(plan.focus[k], lowest))
        assert isinstance(sweep.finish(k * S + 1), Measurement)
        assert sweep.remark() == (says if k == 0 else None)
        sweep.forget()
    assert sweep.remark() is None


def level(roll_deg: float, pitch_deg: float) -> Telemetry:
    return Telemetry(
        t_ns=0, board_us=0, depth_m=0.4, roll_deg=roll_deg, pitch_deg=pitch_deg, sensor_depth_m=(0.4,) * 4,
        pulses_us=(1500,) * 8, servos_us=(1500,) * 4, battery_v=12.0, armed=True, ladder=0, flags=0, loop_us=900,
    )  # fmt: skip


def test_a_robot_that_tilts_repeats_its_sweep() -> None:
    sweep = Sweep(FIT, 30)
    sweep.telemetry(level(20.0, 0.0))  # before the sweep: does not matter
    for swing, kind in ((0.8, Measurement), (1.2, Rejected), (0.0, Measurement)):
        plan = sweep.start(0)
        for angle in (-swing, swing):
            sweep.telemetry(level(5.0, angle))
        frames(sweep, plan, 431.0)
        result = sweep.finish(S)
        assert isinstance(result, kind)
        assert kind is Measurement or "tilted by 2.4 degrees" in result.reason


def test_a_failed_tracking_sweep_is_followed_by_a_wider_one_then_by_a_full_one() -> None:
    sweep = Sweep(FIT, 30)
    frames(sweep, sweep.start(0), 431.0)
    assert isinstance(sweep.finish(S), Measurement)
    spans = []
    for _ in range(3):
        plan = sweep.start(S)
        spans.append((len(plan.focus) - 1, plan.focus[-1] - plan.focus[1]))
        frames(sweep, plan, 431.0, found=False)
        assert isinstance(sweep.finish(2 * S), Rejected)
    assert [steps for steps, _ in spans] == [TRACK_STEPS, TRACK_STEPS, 30]
    assert spans[1][1] == pytest.approx(2 * spans[0][1], abs=2)


def test_a_sweep_without_frames_is_given_up() -> None:
    sweep = Sweep(FIT, 8)
    sweep.start(0)
    assert sweep.finish(2 * S) is None
    assert isinstance(sweep.finish(4 * S), Rejected)
    assert not sweep.running


def test_where_frames_come_slowly_full_sweeps_are_halved() -> None:
    sweep, now = Sweep(FIT, 30), 0
    steps = []
    for _ in range(3):
        plan = sweep.start(now)
        steps.append(len(plan.focus) - 1)
        now += 8 * S
        result = sweep.finish(now)
        assert isinstance(result, Rejected) and "not finished in time" in result.reason
    assert steps == [30, 15, 8]


def test_frames_of_another_sweep_pass_by() -> None:
    sweep = Sweep(FIT, 8)
    old = sweep.start(0)
    sweep.forget()
    sweep.start(0)
    frames(sweep, old, 431.0)
    assert sweep.finish(S) is None


# --- lens positions ---
# Lens positions of a full sweep, whichever end of them is infinity.

LENS_POSITIONS_FIT = replace(PLAIN, u_inf_m=0.0, lowest=200)


@pytest.mark.parametrize("nearer", ["larger", "smaller"])
def test_a_full_sweep_passes_infinity_and_both_ends_in_equal_steps(nearer: str) -> None:
    fit = LENS_POSITIONS_FIT if nearer == "larger" else replace(LENS_POSITIONS_FIT, b_m=-130.0, rho0=1000.0)
    lens_positions = full_positions(fit, 30)
    assert lens_positions[0] <= fit.lowest - 60 and lens_positions[-1] >= fit.highest + 60
    infinity = lens_positions[1] <= fit.rho0 if nearer == "larger" else lens_positions[-2] >= fit.rho0
    assert infinity  # between the second position from either end, where a peak is believed
    steps = {b - a for a, b in itertools.pairwise(lens_positions)}
    assert max(steps) - min(steps) <= 1 and min(steps) > 0
    assert home_position(lens_positions, fit) < lens_positions[0]


def test_the_other_end_where_smaller_positions_are_nearer() -> None:
    fit = replace(LENS_POSITIONS_FIT, b_m=-130.0, rho0=1000.0)
    assert short_of_infinity(fit, [200, 600, 990, 1010]) is None
    says = short_of_infinity(fit, [200, 600, 900, 930, 930])
    assert says == "the lens stops at 930, infinity is at 1000: no range to targets beyond 1.3 m"


@pytest.mark.parametrize(("late_s", "told"), [(0.0, False), (0.01, False), (0.06, True), (-0.06, True)])
def test_peaks_that_lie_farther_on_the_faster_the_lens_went_contradict_the_timing(late_s: float, told: bool) -> None:
    fit = replace(FIT, width=118.0)  # as of most lenses: a step of a tracking sweep is longer than one of a full sweep
    sweep, late = Sweep(fit, 30), LateFrames()
    for _ in range(6):  # a full one and five of tracking
        plan = sweep.start(0)
        pace = (plan.focus[-1] - plan.focus[1]) / (0.1 * (len(plan.focus) - 2))
        assert late.late_s() is None
        peak = 431.0 + late_s * pace
        clarity = {k: 10 + 90 / (1 + ((at - peak) / 118) ** 2) for k, at in enumerate(plan.focus)}
        frames(sweep, plan, peak, t_ns=lambda index: index * S // 10, clarity=clarity.get)
        found = sweep.finish(100 * S)
        assert isinstance(found, Measurement) and found.pace == pytest.approx(pace)
        late.add(found, FIT.noise)
    assert (late.late_s() is not None) == told
    if told:
        assert late.late_s()[0] == pytest.approx(late_s, abs=0.01)


def test_a_peak_that_later_sweeps_do_not_find_again_contradicts_the_timing_too() -> None:
    sweep, late = Sweep(FIT, 30), LateFrames()

    def one(**changes) -> Measurement | Rejected:
        frames(sweep, sweep.start(0), 431.0, **changes)
        result = sweep.finish(S)
        late.add(result, FIT.noise)
        return result

    assert isinstance(one(), Measurement)
    one(found=False)  # not in view: that says nothing
    for _ in range(LOST):
        assert late.contradiction() is None
        assert isinstance(one(clarity=50.0), Rejected)
    assert "did not find again" in late.contradiction()
    one()
    one()  # a tracking sweep
    assert late.contradiction() is None
