"""A dive in which people ordered: it replays byte for byte, and what it left names who ordered what."""

from pathlib import Path

import pytest

from agent.core.codec import decode, encode
from agent.core.step_io import Outputs
from replay.check.check import check
from replay.check.explain import explain
from replay.check.reexecute import describe_inputs, open_boxes
from replay.files.channels import STEP_OUT, Entry
from replay.files.log import Record, read
from replay.report.report import report
from replay.report.tables import orders, remarks
from replay.report.timeline import open_run
from replay.viewers.viewer_channels import ViewerChannels
from tests.network.scripted_agent import CALIBRATION
from tests.replay.rewritten import rewritten
from tests.replay.step_box import StepBox
from tests.robot.ordering import FLEET, START_NS, Ordering

DONE = (
    ("ann", "hold", {"depth_m": 0.2}),
    ("ann", "look", {"pan_deg": 20.0}),
    ("bob", "set", {"name": "send_hz", "value": 5.0}),
    ("bob", "hold", {}),
    ("ann", "look", {"pan_deg": -20.0, "tilt_deg": 3.0}),
    ("cy", "stop", {}),
    ("ann", "arm", {}),
    ("ann", "set", {"name": "sweeps", "value": 0.0}),
    ("bob", "resume", {}),
    ("cy", "surface", {}),
)
REFUSED = (
    ("ann", "hold", {"depth_m": 2.0}),
    ("ann", "goto", {"x_m": 0.5, "y_m": 0.5}),
    ("bob", "lamp", {"light": 1.0}),
    ("bob", "fly", {}),
    ("ann", "look", {"pan_deg": 200.0}),
)


@pytest.fixture(scope="module")
def box(tmp_path_factory) -> Path:
    """A robot's recording with 20 orders, of which some are refused, old, unreadable or come again."""
    robot = Ordering()
    robot.run(3.0)
    given = 0
    for (console, verb, args), (other, wrong, how) in zip(DONE, (*REFUSED, *REFUSED), strict=True):
        assert robot.give(verb, args, console=console).ok
        robot.run(0.6)
        if given % 4 == 0:
            assert not robot.give(wrong, how, console=other).ok
        else:
            order = robot.order("look", {"pan_deg": 1.0}, console="late", seen=(START_NS, START_NS))
            assert not robot.step(order).answers[0].ok
        robot.run(0.4)
        given += 2
    assert given == 20
    again = robot.order("hold", {"depth_m": 0.2}, number=1)
    robot.step(again, again)
    file = tmp_path_factory.mktemp("orders") / "r1.mcap"
    with StepBox(file, FLEET, "r1", CALIBRATION, START_NS) as written:
        for now_ns, inputs, outputs in robot.steps:
            written.add(now_ns, inputs, outputs)
    return file


def test_it_replays_byte_for_byte(box: Path) -> None:
    (result,) = check([box]).results
    assert result.verdict == "identical" and result.steps == len(list(open_boxes([box])[0].steps()))


def test_another_answer_is_a_difference(box: Path, tmp_path: Path) -> None:
    def lie(record: Record) -> bytes:
        if record.channel != STEP_OUT.name:
            return record.data
        outputs = decode(record.data, Outputs, len(record.data))
        return encode(outputs).replace(b"hold depth_m=0.2", b"hold depth_m=0.3")

    (result,) = check([rewritten(box, tmp_path / "r1.mcap", lie)]).results
    assert result.verdict == "differs" and "answers.order" in result.fields


def test_the_black_box_has_each_order_with_its_console(box: Path) -> None:
    steps = [step for b in open_boxes([box]) for step in b.steps() if b"orders" in step.inputs]
    said = [line for step in steps for line in describe_inputs(step) if line.startswith("order of ")]
    assert len(said) == 22
    assert "order of cy" in " ".join(said) and said[0].endswith("hold depth_m=0.2")
    assert any("refused: no verb 'fly'" in line for line in said)


def test_explain_and_viewers_name_who_ordered_what(box: Path) -> None:
    told = " ".join(explain(box, str(t)) for t in range(4, 15))
    assert "log, warning: cy orders: surface" in told and "log, warning: refuses what bob orders" in told
    channels = ViewerChannels(FLEET, "r1", CALIBRATION)
    lines = []
    for record in read(box):
        entry = Entry(
            record.channel, record.log_time_ns, record.log_time_ns, record.sequence, record.data, "msgpack", {}
        )
        lines += [made.data for made in channels(entry) if "log" in made.channel]
    assert any(b"cy orders: surface" in line for line in lines)
    assert any(b"refuses what bob orders" in line for line in lines)


@pytest.mark.usefixtures("undrawn")
def test_the_report_has_a_table_of_orders(box: Path) -> None:
    page = report(box.parent).read_text(encoding="utf-8")
    assert "What people ordered" in page
    run = open_run(box.parent)
    table = orders(run)
    assert table is not None
    _, *rows = table.rows
    assert len(rows) == 20  # one that came again stands once
    assert rows[0][2:] == ["ann", "hold depth_m=0.2", "does it"]
    assert ["bob", "cannot be read"] in [row[2:4] for row in rows]
    rest = remarks(run)
    assert rest is None or not any(" orders: " in cell for row in rest.rows for cell in row)
