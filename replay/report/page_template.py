"""The page: one HTML file without script, and without anything from elsewhere; on a phone its figures form a column.
And what it is made of: sections of tables and figures."""

from __future__ import annotations

import io
import re
from typing import NamedTuple

import matplotlib
from markupsafe import Markup
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from replay.report.tables import Table

PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{{ title }}</title>
<style>
body { font: 16px/1.45 system-ui, sans-serif; max-width: 68em; margin: 0 auto; padding: 1em; color: #222 }
h1 { font-size: 1.5em; margin: .3em 0 }
h2 { font-size: 1.2em; margin: 1.6em 0 .2em; border-top: 1px solid #ccc; padding-top: .8em }
.pass, .identical { color: #060 } .fail { color: #a00 } .note { color: #555; max-width: 45em }
nav a { margin-right: 1em; white-space: nowrap }
.figures { display: grid; gap: 1em; align-items: start;
  grid-template-columns: repeat(auto-fit, minmax(min(100%, 20em), 1fr)) }
figure { margin: 0; min-width: 0; max-width: 34em } svg { width: 100%; height: auto }
.wide { overflow-x: auto; margin-bottom: 1.2em } table { border-collapse: collapse; font-variant-numeric: tabular-nums }
td, th { padding: .25em .7em; text-align: right; border-bottom: 1px solid #ddd; white-space: nowrap }
@media (max-width: 30em) { td, th { padding: .2em .35em; font-size: .85em } th { white-space: normal } }
td:first-child, th:first-child, #valid td:last-child, #valid th:last-child { text-align: left }
</style>
</head>
<body>
<h1>{{ title }}{% if verdict %}: <span class="{{ verdict }}">{{ verdict }}</span>{% endif %}</h1>
{% for reason in reasons %}<p class="fail">{{ reason }}</p>
{% endfor %}<p>{{ about }}</p>
<nav>{% for section in sections %}<a href="#{{ section.id }}">{{ section.title }}</a> {% endfor %}</nav>
{% for section in sections %}
<section id="{{ section.id }}">
<h2>{{ section.title }}</h2>
<p class="note">{{ section.note }}</p>
{% for table in section.tables %}
<p class="note">{{ table.about }}</p>
<div class="wide"><table>
<tr>{% for cell in table.rows[0] %}<th>{{ cell }}</th>{% endfor %}</tr>
{% for row in table.rows[1:] %}<tr>{% for cell in row %}<td>{{ cell }}</td>{% endfor %}</tr>
{% endfor %}</table></div>
{% endfor %}
<div class="figures">
{% for figure in section.figures %}<figure>{{ figure }}</figure>
{% endfor %}</div>
</section>
{% endfor %}
</body>
</html>
"""


class Section(NamedTuple):
    id: str
    title: str
    note: str
    tables: list[Table]
    figures: list[Markup]


def svg(figure: Figure) -> Markup:
    """The figure as an element of the page."""
    text = io.StringIO()
    with matplotlib.rc_context(
        {"svg.fonttype": "none", "svg.hashsalt": "aucamp"}
    ):  # text stays text; same ids each time
        FigureCanvasSVG(figure).print_svg(text, metadata={"Date": None})  # type: ignore[no-untyped-call]
    svg = text.getvalue()[text.getvalue().index("<svg") :]
    return Markup(re.sub(r' (width|height)="[\d.]+pt"', "", svg, count=2))  # its box decides how large it is
