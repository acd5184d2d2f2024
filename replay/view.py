"""The fleet live in Foxglove: the viewer channels of a recording, over a WebSocket on this machine alone.

Only what robots show on the network is there, previews of their cameras included; the frames themselves stay on the
robots' own computers, in their black boxes.
"""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from agent.clock import machine
from agent.clock.clock import Clock
from agent.core.config import ConfigError, Fleet
from replay.files.backlog import Entry
from replay.files.clock_rate import RateNotes
from replay.recorder import CHANNELS, PERIOD_S, Arrivals, receiving
from replay.roll_call import RollCall
from replay.viewers.layout import foxglove_layout, shipped
from replay.viewers.viewer_channels import ViewerChannels

HOST = "127.0.0.1"  # whoever can reach the port sees everything: other hosts come through ssh -L
PORT = 8765  # Foxglove's own


def view(
    fleet: Fleet,
    stop: threading.Event,
    clock: Clock,
    port: int = PORT,
    say: Callable[[str], None] = lambda line: None,
    keys: Path | None = None,
) -> None:
    """Serve until `stop` is set. Raises ConfigError without the extra `view`, or if the port is taken.

    `say` gets lines for a person: where to look, and who is not heard. `keys`: the folder of a secured fleet's
    certificates.
    """
    try:
        import foxglove  # the SDK, an extra; our own module of that name is replay.viewers.foxglove
    except ImportError:
        raise ConfigError("the live view needs the extra `view`; in your clone: pip install -e '.[view]'") from None
    arrivals, rate, derive = Arrivals(clock.now_ns), RateNotes(clock), ViewerChannels(fleet)
    context = foxglove.Context()
    channels: dict[str, Any] = {}

    def show(entry: Entry) -> None:
        if entry.channel not in channels and len(channels) == CHANNELS:
            raise ValueError("too many channels")
        if entry.channel not in channels and entry.schema is not None:
            schema = foxglove.Schema(**entry.schema._asdict())
            channels[entry.channel] = foxglove.Channel(
                entry.channel, schema=schema, message_encoding=entry.encoding, context=context
            )
        channels[entry.channel].log(entry.data, log_time=entry.log_time_ns)

    with receiving(fleet, arrivals, "view", keys):
        try:
            server = foxglove.start_server(name=f"aucamp {fleet.fleet}", host=HOST, port=port, context=context)
        except RuntimeError as error:
            raise ConfigError(f"port {port} of {HOST}: {error}; choose another with --port") from None
        try:
            say(f"open a connection to ws://{HOST}:{port} in Foxglove; {where_the_layout_is(fleet)}; Ctrl-C ends it")
            roll = RollCall(fleet, say)
            while not machine.wait(stop, PERIOD_S):
                for entry in (*arrivals.drain(), *rate.due()):
                    show_all_of(entry, derive, show, arrivals.trouble)
                roll.look(arrivals.robots)
            roll.end()
            if arrivals.raised:
                say(f"not shown: {', '.join(f'{count} messages {kind}' for kind, count in arrivals.raised.items())}")
        finally:
            server.stop()


def show_all_of(
    entry: Entry,
    derive: Callable[[Entry], Iterable[Entry]],
    show: Callable[[Entry], None],
    trouble: Callable[[str, Exception], None],
) -> None:
    """Show what follows from one message. Where it raises, `trouble` is told, and the next one is shown as ever."""
    try:
        for derived in derive(entry):
            show(derived)
    except Exception as error:  # noqa: BLE001 - whatever a message does, the view goes on
        trouble(entry.channel, error)


def where_the_layout_is(fleet: Fleet) -> str:
    """Words for a person: the one that comes with us, if it fits the fleet."""
    path = shipped("foxglove.json")
    if json.loads(path.read_text(encoding="utf-8")) == foxglove_layout(fleet):
        return f"the layout is {path}"
    return "`aucamp replay layout` writes a layout for this fleet"
