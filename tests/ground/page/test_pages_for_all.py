"""Who cannot see well, or has no mouse, uses our pages too: axe-core, somebody else's judgement, finds nothing."""

import shutil
from importlib.util import find_spec
from pathlib import Path

import pytest

from agent.core.config import Fleet, Pose, Robot, Target
from agent.robot.fleet_reader import load_fleet
from replay.report.report import report
from tests.network.conftest import unused_port
from tests.network.looking.page_process import Tab, browser, fleet_on_disk, page_process
from tests.network.looking.scripted_robots import JPEG, scripted
from tests.places import GOLDEN
from tests.replay.overheard_run import overheard_run

pytest.importorskip("websockets", reason="the extra `page` is not installed")
SPEC = find_spec("axe_playwright_python")
if SPEC is None:
    pytest.skip("axe-core is not installed: pip install axe-playwright-python", allow_module_level=True)
AXE = (Path(SPEC.origin).parent / "axe.min.js").read_text(encoding="utf-8")

pytestmark = pytest.mark.timeout(600)
PHONE, DESK = (390, 844, "light"), (1280, 800, "dark")  # axe takes ten seconds for each page


@pytest.fixture(scope="module")
def chromium():
    with browser() as found:
        yield found


def run_of(name: str, folder: Path) -> Path:
    """A dive with the recordings of its robots and of the fleet."""
    for box in (GOLDEN / name).glob("*.mcap"):
        shutil.copy(box, folder)
    overheard_run(folder, folder / "fleet.mcap")
    return folder


def complaints(tab: Tab) -> list[str]:
    """What axe-core finds: rule, and where."""
    tab.page.evaluate(AXE + ";0")
    found = tab.page.evaluate("axe.run()")
    assert len(found["passes"]) > 5, "it looked"
    return [f"{one['id']}: {[node['target'] for node in one['nodes']]}" for one in found["violations"]]


@pytest.mark.parametrize(("name", "width", "height", "scheme"), [("orders", *PHONE), ("survey", *DESK)])
def test_a_report(chromium, tmp_path, name, width, height, scheme) -> None:
    page = report(run_of(name, tmp_path), tmp_path / "report.html")
    tab = Tab(chromium, page.as_uri(), viewport={"width": width, "height": height}, color_scheme=scheme)
    tab.page.evaluate("document.querySelectorAll('details').forEach(one => one.open = true)")
    assert not complaints(tab)
    tab.page.close()


def test_a_recording(chromium, tmp_path) -> None:
    width, height, scheme = PHONE
    with page_process(run_of("orders", tmp_path)) as served:
        tab = Tab(chromium, served.address, viewport={"width": width, "height": height}, color_scheme=scheme)
        tab.says("#came_said", "ball")
        tab.page.click("#came summary")
        assert not complaints(tab)
        tab.page.close()


def test_a_fleet_that_is_ordered_about(chromium, tmp_path) -> None:
    width, height, scheme = DESK
    address = {name: f"tcp/127.0.0.1:{unused_port()}" for name in ("r1", "r2")}
    robots = {
        name: Robot(
            neighbours=tuple(other for other in address if other != name),
            listen=listen,
            serial=f"twin:{name}",
            camera=f"twin:{name}",
            pose=Pose(x_m=0.4, y_m=0.3, yaw_deg=90.0),
            calibration=f"{name}.toml",
        )
        for name, listen in address.items()
    }
    fleet = Fleet(fleet="test", target={"ball": Target(radius_m=0.07)}, robot=robots)
    path = fleet_on_disk(fleet, tmp_path, JPEG)
    with scripted(load_fleet(path)), page_process(path, "--as", "ann", "--out", str(tmp_path)) as served:
        tab = Tab(chromium, served.address, viewport={"width": width, "height": height}, color_scheme=scheme)
        tab.says("#sentence", "2 of 2 robots heard")
        tab.page.click("#stop")
        tab.says("#stopped", "all stopped")
        assert not complaints(tab)
        tab.page.click("#help")
        assert not complaints(tab)
        tab.page.close()
