"""What a robot's black box holds, channel by channel. The calls come from several threads; none of them waits."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import count
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from agent.config import Fleet, dump
from agent.messages import Sighting, encode
from agent.ranging.calibration import Calibration
from replay.depth import MeasureDepth
from replay.derive import Derive
from replay.frames import FRAME, VISION, picture
from replay.log import LogWriter
from replay.names import unused
from replay.recover import STEP_IN, STEP_OUT

FROM_BOARD, TO_BOARD = "/raw/serial/from_board", "/raw/serial/to_board"  # the bytes as the port gave and took them


def black_box_log(
    folder: Path,
    fleet: Fleet,
    robot: str,
    calibration: Calibration,
    run: Mapping[str, object],
    views: bool,
    depth: MeasureDepth | None = None,
) -> LogWriter:
    """The file `<robot>.mcap`, or `<robot>.2.mcap` and so on after a restart.

    `views`: with channels for viewers; `depth`: what makes depth maps for them.
    """
    return LogWriter(
        unused(folder / f"{robot}.mcap"),
        run,
        attachments={"fleet.toml": dump(fleet), "calibration.toml": dump(calibration)},
        splits_at=STEP_IN,
        derive=Derive(fleet, robot, calibration, depth) if views else None,
    )


class BlackBoxWriter:
    """Gives each channel of the black box its name, number and times."""

    def __init__(self, log: LogWriter, clock: Callable[[], int], lossless: bool = False) -> None:
        """`clock` gives Unix nanoseconds that never step back; `lossless`: frames as PNG, nine times as large."""
        self._log, self._clock, self._lossless = log, clock, lossless
        self._frames, self._chunks = count(), {FROM_BOARD: count(), TO_BOARD: count()}

    def step(self, step: int, now_ns: int, inputs: bytes, outputs: bytes | None) -> None:
        """One call of Agent.step, as encoded messages; `outputs` is None when it raised."""
        self._log.write(STEP_IN, now_ns, now_ns, step, inputs, metadata={"schema": "aucamp.Inputs"})
        if outputs is not None:
            self._log.write(STEP_OUT, now_ns, now_ns, step, outputs, metadata={"schema": "aucamp.Outputs"})

    def frame(self, image: NDArray[np.uint8], roi: tuple[int, int, int, int], *sightings: Sighting) -> None:
        """A frame and what vision found in it, of each target that it looked for; called on vision's thread."""
        number, now_ns = next(self._frames), self._clock()
        data = picture(image, roi, sightings[0], self._lossless)
        about = {"schema": "aucamp.Picture"}
        self._log.write(FRAME, now_ns, sightings[0].t_ns, number, data, metadata=about, expendable=True)
        about = {"schema": "aucamp.Sighting"}
        for sighting in sightings:
            self._log.write(VISION, now_ns, sighting.t_ns, number, encode(sighting), metadata=about)

    def serial(self, from_board: bool, data: bytes) -> None:
        """Bytes of the tether; called on the port's thread."""
        channel, now_ns = FROM_BOARD if from_board else TO_BOARD, self._clock()
        number = next(self._chunks[channel])
        self._log.write(channel, now_ns, now_ns, number, data, encoding="application/octet-stream")
