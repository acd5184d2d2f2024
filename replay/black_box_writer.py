"""What a robot's black box holds, channel by channel. The calls come from several threads; none of them waits."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import count
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from agent.core.codec import encode
from agent.core.config import Fleet, dump
from agent.core.ranging.camera_model import Calibration
from agent.core.step_io import Sighting
from replay.files import channels
from replay.files.channels import entry_on
from replay.files.frames import frame_entries
from replay.files.info import RateNotes
from replay.files.log import LogWriter
from replay.files.mcap_file import unused
from replay.viewers.viewer_channels import MeasureDepth, ViewerChannels


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
        splits_at=channels.STEP_IN.name,
        derive=ViewerChannels(fleet, robot, calibration, depth) if views else None,
    )


class BlackBoxWriter:
    """Gives each channel of the black box its name, number and times."""

    def __init__(
        self,
        log: LogWriter,
        robot: str,
        clock: Callable[[], int],
        lossless: bool = False,
        rate: RateNotes | None = None,
    ) -> None:
        """`clock` gives Unix nanoseconds that never step back; `lossless`: every frame as PNG, nine times as large.

        `rate`: notes of how fast that clock goes, to be written as well.
        """
        self._log, self._robot, self._clock, self._lossless, self._rate = log, robot, clock, lossless, rate
        self._frames, self._chunks = count(), {channels.FROM_BOARD: count(), channels.TO_BOARD: count()}

    def step(self, step: int, now_ns: int, inputs: bytes, outputs: bytes | None) -> None:
        """One call of Agent.step, as encoded messages; `outputs` is None when it raised."""
        self._log.put(entry_on(channels.STEP_IN, now_ns, now_ns, step, inputs))
        if outputs is not None:
            self._log.put(entry_on(channels.STEP_OUT, now_ns, now_ns, step, outputs))
        for note in self._rate.due() if self._rate is not None else ():
            self._log.put(note)

    def frame(self, image: NDArray[np.uint8], roi: tuple[int, int, int, int], *sightings: Sighting) -> None:
        """A frame and what vision found in it, of each target that it looked for; called on vision's thread."""
        number, now_ns = next(self._frames), self._clock()
        for entry in frame_entries(self._robot, number, now_ns, image, roi, sightings[0], self._lossless):
            self._log.put(entry)
        for sighting in sightings:
            self._log.put(entry_on(channels.VISION, now_ns, sighting.t_ns, number, encode(sighting)))

    def serial(self, from_board: bool, data: bytes) -> None:
        """Bytes of the tether; called on the port's thread."""
        channel, now_ns = channels.FROM_BOARD if from_board else channels.TO_BOARD, self._clock()
        self._log.put(entry_on(channel, now_ns, now_ns, next(self._chunks[channel]), data))
