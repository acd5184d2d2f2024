"""Tags that the lens shows too blurred do not count, whatever the picture says."""

import pytest
from msgspec.structs import replace

from agent.capabilities.swim.projection import WIDTH_PX, readable
from agent.core.ranging.focus import lens_position
from agent.core.step_io import SeenTag
from tests.capabilities.swim.tank_with_tags import VIEW
from tests.known_lens import PLAIN

SIZE_M, SIDE_PX = 0.08, 80.0
AWAY_M = SIZE_M * VIEW.f_px / SIDE_PX
SHARP = lens_position(PLAIN, AWAY_M)
TAG = SeenTag(3, ((0.0, 0.0), (0.1, 0.0), (0.1, 0.1), (0.0, 0.1)), SIDE_PX, 0.0, True)
MODULE = PLAIN.width * (SIDE_PX / 8) / WIDTH_PX  # so far off focus the blur is a module wide, lens positions


@pytest.mark.parametrize("way", [-1.0, 1.0])
def test_a_tag_counts_until_its_blur_is_a_module_wide(way) -> None:
    assert readable([TAG], SIZE_M, VIEW, PLAIN, SHARP + 0.99 * way * MODULE) == [TAG]
    assert readable([TAG], SIZE_M, VIEW, PLAIN, SHARP + 1.01 * way * MODULE) == []


def test_nothing_is_left_out_where_nobody_knows_the_lens() -> None:
    assert readable([TAG], SIZE_M, VIEW, PLAIN, None) == [TAG]


def test_what_no_lens_position_shows_sharp_does_not_count() -> None:
    near, fit = replace(TAG, size_px=1e5), replace(PLAIN, u_inf_m=0.01)
    assert readable([near], SIZE_M, VIEW, fit, SHARP) == []
