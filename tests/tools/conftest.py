import cv2
import pytest

from tests.tools.planes import two_planes


@pytest.fixture
def planes(tmp_path):
    """Thirteen photographs at 0.00, 0.05, … 0.60: the left plane sharp at 0.21, the right one at 0.388."""
    directory = tmp_path / "planes"
    directory.mkdir()
    rows = ["file,focus_position"]
    for index in range(13):
        cv2.imwrite(str(directory / f"{index:02}.png"), two_planes(0.05 * index, 0.21, 0.388, 10.0))
        rows.append(f"{index:02}.png,{0.05 * index:.2f}")
    (directory / "positions.csv").write_text("\n".join(rows))
    return directory
