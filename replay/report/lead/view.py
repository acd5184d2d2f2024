"""A view of the tank from above as SVG: metres of the world frame to units of the picture."""

from __future__ import annotations

import math
from collections.abc import Sequence

from markupsafe import escape

from agent.core.messages import Symmetric

SIGMAS = 3.0  # of ellipses, as on the page

Point = tuple[float, float]


class View:
    """Metres to the picture's units."""

    def __init__(self, scale: float, left: float, top: float) -> None:
        self.scale, self._left, self._top = scale, left, top

    def at(self, x_m: float, y_m: float) -> str:
        return f"{self._left + x_m * self.scale:.1f} {self._top - y_m * self.scale:.1f}"

    def circle(self, kind: str, x_m: float, y_m: float, r: float) -> str:
        x, y = self.at(x_m, y_m).split()
        return f'<circle class="{kind}" cx="{x}" cy="{y}" r="{r:.1f}"/>'

    def text(self, kind: str, x_m: float, y_m: float, up: float, text: str) -> str:
        x, y = (float(part) for part in self.at(x_m, y_m).split())
        return f'<text class="{kind}" x="{x:.1f}" y="{y - up:.1f}" text-anchor="middle">{escape(text)}</text>'

    def way(self, kind: str, points: Sequence[Point]) -> str:
        return "" if len(points) < 2 else f'<path class="{kind}" d="M{"L".join(self.at(*p) for p in points)}"/>'

    def cross(self, kind: str, x_m: float, y_m: float, arm: float) -> str:
        return f'<path class="{kind}" d="M{self.at(x_m, y_m)}m{-arm} 0h{2 * arm}m{-arm} {-arm}v{2 * arm}"/>'

    def sure(self, x_m: float, y_m: float, cov_m2: Symmetric | None) -> str:
        """The ellipse of a belief, from above; nothing where it has none."""
        if cov_m2 is None:
            return ""
        a, b, c = cov_m2[0], cov_m2[1], cov_m2[3]  # xx, xy, yy
        mean, half = (a + c) / 2.0, math.hypot((a - c) / 2.0, b)
        large, small = (SIGMAS * self.scale * math.sqrt(max(value, 0.0)) for value in (mean + half, mean - half))
        turn = -math.degrees(math.atan2(2.0 * b, a - c)) / 2.0  # the picture's y runs down
        where = f'transform="translate({self.at(x_m, y_m)}) rotate({turn:.1f})"'
        return f'<ellipse class="sure" rx="{large:.2f}" ry="{small:.2f}" {where}/>'
