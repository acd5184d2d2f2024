"""Colours of everything that shows a run: the report, its figures, and the page of a fleet; light, and dark."""

from __future__ import annotations

from types import MappingProxyType

_LIGHT = """
  --ground: #f3f5f7; --panel: #ffffff; --line: #d9dee4; --soft: #eceff3; --text: #16202b; --dim: #5b6877;
  --water: #e3eff8; --deep: #d3e5f3; --grid: #c3d5e4; --wall: #7c90a4; --good: #147a41; --warn: #96580a; --bad: #c3202f;
  --focus: #1660d0; --tag: #8b98a6; --lamp: #f2b705; --some: #f5dc95; --known: #8fd0a4; --thing: #6b7785;
  --r0: #1763c6; --r1: #c2500c; --r2: #18803f; --r3: #a3219f; --r4: #0b7285; --r5: #8a6a00;
  --r6: #6a35c9; --r7: #b81c4f;
"""
_DARK = """
  --ground: #0f151c; --panel: #17202a; --line: #2c3947; --soft: #202b37; --text: #e4eaf0; --dim: #94a3b3;
  --water: #14283a; --deep: #102131; --grid: #24405a; --wall: #5d7891; --good: #5fd08a; --warn: #f0b04f; --bad: #ff6b74;
  --focus: #78b4ff; --tag: #6f8294; --lamp: #ffd75e; --some: #5f5320; --known: #24593a; --thing: #8e9aa8;
  --r0: #74b3ff; --r1: #ff9f62; --r2: #66d58f; --r3: #ec8df2; --r4: #58d3e2; --r5: #e8c451;
  --r6: #b99bff; --r7: #ff8fae;
"""
ROBOTS = 8  # colours; the ninth robot has that of the first
PALETTE = f"""
:root {{{_LIGHT}}}
@media screen and (prefers-color-scheme: dark) {{
  :root {{{_DARK}  }}
}}"""  # paper stays white

# What matplotlib draws in, by what it shall be: its own cycle is the robots', greys are what stands back.
THEMED = MappingProxyType(
    {
        "#000000": "text",
        "#ffffff": "panel",
        "#1f77b4": "r0",
        "#ff7f0e": "r1",
        "#2ca02c": "r2",
        "#d62728": "r3",
        "#9467bd": "r4",
        "#8c564b": "r5",
        "#e377c2": "r6",
        "#7f7f7f": "r7",
        "#ff0000": "bad",
        "#808080": "dim",
        "#999999": "tag",
        "#bfbfbf": "grid",
        "#cccccc": "line",
        "#d9d9d9": "line",
    }
)
