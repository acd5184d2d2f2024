"""The operator's page in a real browser, as a person uses it: a fleet of two, watched, ordered about, lost."""

import shutil
import signal
import threading
import time

import pytest
from msgspec.structs import replace

from agent.core.config import Fleet, Landmarks, Navigation, Pose, Robot, Tag, Target, dump
from agent.core.ranging.camera_model import Calibration
from agent.robot.fleet_reader import load_fleet
from tests.known_lens import CAMERA, PLAIN
from tests.network.conftest import unused_port
from tests.network.looking.page_process import FREEZE, TAKES, Tab, browser, fleet_on_disk, page_process
from tests.network.looking.scripted_robots import JPEG, scripted
from tests.places import GOLDEN
from tests.replay.overheard_run import overheard_run
from tests.waiting import until

pytest.importorskip("websockets", reason="the extra `page` is not installed")

STATES = "[...robots.values()].map(r => newest(r)?.t ?? -1)"


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    robots = {
        name: Robot(
            neighbours=(other,),
            listen=f"tcp/127.0.0.1:{unused_port()}",
            serial=f"twin:{name}",
            camera=f"twin:{name}",
            pose=Pose(x_m=x_m, y_m=0.3, yaw_deg=90.0),
            calibration=f"{name}.toml",
        )
        for name, other, x_m in (("r1", "r2", 0.4), ("r2", "r1", 1.1))
    }
    fleet = Fleet(fleet="test", target={"ball": Target(radius_m=0.07)}, robot=robots)
    folder = tmp_path_factory.mktemp("page")
    for name in robots:
        lens = Calibration(robot=name, made="2026-01-01", source="test", focus=PLAIN, camera=CAMERA)
        (folder / f"{name}.toml").write_text(dump(lens), encoding="utf-8")
    return fleet_on_disk(fleet, folder, JPEG)


@pytest.fixture(scope="module")
def chromium():
    with browser() as found:
        yield found


@pytest.fixture(scope="module")
def robots(path, chromium):
    with scripted(load_fleet(path)) as found:
        yield found


@pytest.fixture(scope="module")
def served(path, robots):
    with page_process(path, "--as", "ann", "--out", str(path.parent)) as page:
        yield page


@pytest.fixture
def tab(chromium, served):
    found = Tab(chromium, served.address, viewport={"width": 1440, "height": 900})
    found.says("#sentence", "2 of 2 robots heard")
    yield found
    found.page.close()
    assert not found.outside, "it asks nobody but its server"
    assert not found.complaints


def test_who_looks_sees_the_fleet(tab) -> None:
    assert "The ball: seen by all, known to ± 1.5 mm." in tab.says("#sentence", "seen by all")
    assert tab.page.inner_text("#kind") == "LIVE"
    tab.says("#card_r1", "picture 0.")
    tab.says("#card_r1", "0.40 m")
    tab.says("#card_r1 dt:text-is('ball') + dd", "sees it, ± 1.5 mm, consistent")
    tab.says("#card_r1 dt:text-is('lens') + dd", "position 600, sharp at 0.25 m")  # -0.01 + 130 / (600 - 100)
    assert tab.page.is_hidden("#send"), "they are moored"
    tab.says("#log", "r2 is here")
    before = tab.page.evaluate(STATES)
    until(lambda: all(now > was for now, was in zip(tab.page.evaluate(STATES), before, strict=True)))


def test_a_battery_that_runs_low_and_what_the_module_does_about_it(tab, robots) -> None:
    """Both limits are from where they are in force: kernel and firmware."""
    row = {name: f"#card_r1 dt:text-is('{name}') + dd" for name in ("battery", "failsafe")}

    def looks() -> str:
        return tab.page.get_attribute(row["battery"], "class")

    tab.says(row["battery"], "14.2 V")
    assert looks() == "" and not tab.page.locator(row["failsafe"]).count()
    try:
        robots["r1"].battery_v = 13.1
        tab.says(row["battery"], "13.1 V")
        until(lambda: looks() == "warn")
        robots["r1"].battery_v, robots["r1"].ladder = 11.8, 2
        tab.says(row["battery"], "11.8 V")
        until(lambda: looks() == "bad")
        tab.says(row["failsafe"], "surfacing by itself")
    finally:
        robots["r1"].battery_v, robots["r1"].ladder = 14.2, 0
    until(lambda: not tab.page.locator(row["failsafe"]).count())


def test_all_are_stopped_and_started_again(tab, robots) -> None:
    tab.page.click("#stop")
    assert tab.says("#stopped", "all stopped: r1 and r2") in tab.page.inner_text("#order_note")
    assert [robot.orders[-1].verb for robot in robots.values()] == ["stop", "stop"]
    tab.says("#sentence", "Motors off: all")
    robots["r1"].armed = True  # by another console
    tab.says("#stopped", "stopped: r2; armed again: r1")
    tab.page.click("#start")
    until(lambda: all(robot.armed for robot in robots.values()))
    tab.page.wait_for_selector("#start", state="hidden")


def test_who_does_not_answer_is_named(tab, robots) -> None:
    robots["r2"].hangs = True
    try:
        tab.page.keyboard.press("s")
        tab.says("#stopped", "stopped: r1; no answer from r2")
        assert "r2" in tab.says("#orders li:first-child", "did not answer within 1 s")
    finally:
        robots["r2"].hangs = False


def test_a_click_in_the_tank_moves_no_robot_before_it_is_confirmed(chromium, path, robots) -> None:
    tags = Landmarks(size_m=0.1, tag=(Tag(id=1, position_m=(0.0, 0.5, 0.25), face="x0"),))
    swims = path.parent / "swims.toml"
    swims.write_text(dump(replace(load_fleet(path), navigation=Navigation(), landmarks=tags)), encoding="utf-8")
    with page_process(swims, "--as", "ann") as page:
        tab = Tab(chromium, page.address, viewport={"width": 1440, "height": 900})
        tab.says("#sentence", "2 of 2 robots heard")
        at = tab.page.evaluate("""() => {   // where of the page the place is
            const box = $("above").getBoundingClientRect(), [x, y] = view($("above"), false).at([0.5, 0.75, 0]);
            return [box.left + x, box.top + y];
        }""")
        tab.page.mouse.click(*at)
        tab.says("#send_go", "Send r1 to 0.50, 0.75 m")
        tab.page.keyboard.press("Escape")
        until(lambda: tab.page.is_disabled("#send_go"))
        tab.page.mouse.click(*at)
        tab.page.select_option("#send_who", "r2")
        assert not [order for robot in robots.values() for order in robot.orders if order.verb == "goto"]
        tab.page.click("#send_go")
        tab.says("#send_came", "r2 goes there")
        tab.page.keyboard.press("s")  # from the list of robots, which has the focus now
        tab.says("#stopped", "all stopped: r1 and r2")
        tab.page.click("#start")
        until(lambda: all(robot.armed for robot in robots.values()))
        tab.page.close()
    assert [order.args for order in robots["r2"].orders if order.verb == "goto"] == [{"x_m": 0.5, "y_m": 0.75}]
    assert not [order for order in robots["r1"].orders if order.verb == "goto"]
    assert not tab.complaints


def test_why_a_robot_refuses_is_read_as_text(tab) -> None:
    tab.page.click("#card_r1 button:has-text('Surface')")
    tab.says("#orders li:first-child", "it is <b>not</b> to")


def test_a_camera_is_turned_by_the_keyboard(tab, robots) -> None:
    tab.page.keyboard.press("2")
    tab.page.keyboard.press("ArrowLeft")
    order = until(lambda: next((order for order in robots["r2"].orders if order.verb == "look"), None))
    assert order.args == {"pan_deg": 10.0, "tilt_deg": 0.0} and order.seen is not None
    assert not [order for order in robots["r1"].orders if order.verb == "look"]


def test_a_box_drawn_by_mouse_is_a_target(tab, robots) -> None:
    tab.says("#card_r1", "frame")
    tab.page.click("#card_r1 .view button")  # larger
    tab.page.evaluate("scrollTo(0, 0)")
    tab.page.locator("#card_r1 canvas").scroll_into_view_if_needed()
    at = tab.page.locator("#card_r1 canvas").bounding_box()
    tab.page.mouse.move(at["x"] + at["width"] / 4, at["y"] + at["height"] / 4)
    tab.page.mouse.down()
    tab.page.mouse.move(at["x"] + at["width"] / 3, at["y"] + at["height"] / 3)
    tab.page.mouse.move(at["x"] + at["width"] / 2, at["y"] + at["height"] / 2)
    tab.page.mouse.up()
    order = until(lambda: next((order for order in robots["r1"].orders if order.verb == "target_box"), None))
    args = dict(order.args)
    assert args.pop("target") == "stone" and isinstance(args.pop("frame"), int)
    assert args == {"x": pytest.approx(160, abs=1), "y": pytest.approx(120, abs=1)} | {
        "width": pytest.approx(160, abs=1),
        "height": pytest.approx(120, abs=1),
    }


def test_a_frozen_page_is_one_message_behind_and_no_more(tab) -> None:
    tab.page.evaluate(TAKES)
    until(lambda: len(tab.page.evaluate("taken")) > 10)
    tab.page.evaluate(FREEZE)
    tab.page.evaluate("taken.length = 0")
    time.sleep(1.5)
    taken = tab.page.evaluate("taken")
    keys = {key for key, _ in taken}
    assert {"image/0", "image/1", "state/r1/ball", "link/r1/ball"} <= keys
    for key in keys:
        ages_ms = [age for name, age in taken if name == key]
        old = [age for age in ages_ms if age > 1000]
        assert len(old) <= 1, (key, ages_ms)
        assert len(ages_ms) > 2, "and goes on"


def test_it_fits_a_phone_and_stop_all_stays_in_reach(chromium, served) -> None:
    tab = Tab(chromium, served.address, viewport={"width": 390, "height": 844}, color_scheme="dark")
    tab.says("#sentence", "2 of 2 robots heard")
    assert tab.page.evaluate("document.documentElement.scrollWidth") <= 390
    tab.page.evaluate("scrollTo(0, document.body.scrollHeight)")
    at = tab.page.locator("#stop").bounding_box()
    assert 0 <= at["y"] < 200 and at["height"] >= 44
    red, green, blue = tab.page.evaluate(
        "getComputedStyle(document.documentElement).backgroundColor.match(/[0-9]+/g).map(Number)"
    )[:3]
    assert max(red, green, blue) < 60, "dark, where the browser asks for it"
    tab.page.close()


def test_names_in_the_tank_do_not_cover_each_other_on_a_phone(chromium, served) -> None:
    tab = Tab(chromium, served.address, viewport={"width": 390, "height": 844})
    tab.says("#sentence", "2 of 2 robots heard")
    tab.page.evaluate("for (const r of robots.values()) r.name = 'a robot of a long name, ' + r.name; dirty = true")
    for canvas in ("above", "side"):
        drawn = f"$('{canvas}').getContext('2d').taken.filter(([left, right]) => right - left > 100)"
        until(lambda drawn=drawn: tab.page.evaluate(f"{drawn}.length") == 2)  # with the names of now
        names = tab.page.evaluate(drawn)
        (left, right, y), (other_left, other_right, other_y) = names
        assert right <= other_left or other_right <= left or abs(y - other_y) >= 13
        assert max(y, other_y) < tab.page.evaluate(f"$('{canvas}').clientHeight - FOOT"), "above the scale"
    tab.page.close()
    tab.page.close()


def test_what_a_survey_has_measured_is_drawn_in_the_colour_of_who_did(chromium, tmp_path) -> None:
    for box in (GOLDEN / "survey").glob("*.mcap"):
        shutil.copy(box, tmp_path)
    overheard_run(tmp_path, tmp_path / "fleet.mcap")
    inked = """[...layers.values()].map(layer => {
      const {width, height} = layer.canvas, data = layer.canvas.getContext("2d").getImageData(0, 0, width, height).data;
      return data.filter((alpha, i) => i % 4 === 3 && alpha).length; })"""
    with page_process(tmp_path) as page:
        tab = Tab(chromium, page.address, viewport={"width": 1440, "height": 900})
        tab.says("#legend", "what was measured, by whom")
        tab.page.evaluate("tell({play: {at_ms: 1e15}})")  # its end
        until(lambda: tab.page.evaluate("surface.map(m => m.robot).sort().join()") == "r1,r1,r2,r2")
        until(lambda: min(tab.page.evaluate(inked), default=0) > 500)
        tab.page.evaluate("tell({play: {at_ms: 0}})")
        until(lambda: tab.page.evaluate("surface.length") == 0)
        until(lambda: tab.page.evaluate("layers.size") == 0)
        assert not tab.complaints
        tab.page.close()


def test_recording_is_switched_on_and_off(tab, path) -> None:
    tab.page.click("#record")
    tab.says("#log_note", "recording into")
    time.sleep(1.0)
    tab.page.click("#record")
    tab.says("#log_note", "recorded:")
    files = list(path.parent.glob("test_*.mcap"))
    assert len(files) == 1
    with page_process(files[0]) as page:
        again = Tab(tab.page.context.browser, page.address)
        assert again.says("#kind", "RECORDING")
        again.says("#sentence", "2 of 2 robots heard")
        again.says("#came_said", "knew its place to ±\u00a01.5\u00a0mm")
        assert not again.page.is_visible("#came_looks svg")
        again.page.click("#came summary")
        assert again.page.locator("#came_looks svg").count() == 2
        assert again.page.is_visible("#came_looks svg >> nth=0")
        assert not again.page.is_visible("#stop")
        again.page.keyboard.press("ArrowRight")  # beyond its end: there it stands
        again.says("#play", "Play")
        again.page.keyboard.press(" ")
        again.says("#play", "Pause")
        again.page.close()
    assert not again.complaints and not again.outside


def test_a_robot_that_hangs_is_silent_on_a_page_that_is_opened_then(tab, served, robots) -> None:
    goes, says = threading.Event(), robots["r1"]._state
    robots["r1"]._state = lambda seq: says(seq) if goes.wait(120) else None
    try:
        tab.says("#card_r1 .age", "silent for 4")
        later = Tab(tab.page.context.browser, served.address)
        assert later.says("#sentence", "robots heard").startswith("1 of 2 robots heard")
        assert "silent for" in later.page.inner_text("#card_r1 .age")
        later.page.close()
    finally:
        goes.set()
        robots["r1"]._state = says
    tab.says("#sentence", "2 of 2 robots heard")


def test_while_its_server_hangs_a_stop_is_not_confirmed(chromium, path, robots) -> None:
    with page_process(path, "--as", "ann") as page:
        tab = Tab(chromium, page.address)
        tab.says("#sentence", "2 of 2 robots heard")
        page.process.send_signal(signal.SIGSTOP)
        try:
            tab.page.click("#stop")
            tab.says("#stopped", "STOP not confirmed", 10.0)
            tab.says("#kind", "NO CONNECTION", 10.0)
            assert "lost" in tab.page.get_attribute("body", "class")
        finally:
            page.process.send_signal(signal.SIGCONT)
        tab.says("#kind", "LIVE")
        tab.says("#stopped", "all stopped: r1 and r2")
        tab.page.click("#start")
        until(lambda: all(robot.armed for robot in robots.values()))
        tab.page.close()
    assert not tab.complaints


def test_without_its_server_the_page_is_grey_and_says_so(chromium, path, robots) -> None:
    with page_process(path) as page:
        tab = Tab(chromium, page.address)
        tab.says("#sentence", "2 of 2 robots heard")
        assert tab.page.is_hidden("#stop"), "who only looks cannot order"
        assert "lost" not in tab.page.get_attribute("body", "class")
    assert "nothing below is of now" in tab.says("#banner", "Connection lost")
    assert "lost" in tab.page.get_attribute("body", "class")
    tab.page.close()
