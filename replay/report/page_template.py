"""The page: one HTML file without script, and without anything from elsewhere; on a phone its figures form a column.
And what it is made of: sections of tables and figures. What experts want is folded away; on paper it is not.
"""

from __future__ import annotations

import io
import re
from typing import NamedTuple

import matplotlib
from markupsafe import Markup
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from replay.report.lead.palette import PALETTE, ROBOTS, THEMED
from replay.report.lead.picture import LOOKS

STYLE = (
    PALETTE
    + LOOKS
    + "".join(f".r{k}name {{ color: var(--r{k}) }} " for k in range(ROBOTS))
    + """
* { box-sizing: border-box }
body { font: 16px/1.5 system-ui, "Segoe UI", "DejaVu Sans", sans-serif; max-width: 66em; margin: 0 auto; padding: 1em;
  color: var(--text); background: var(--ground) }
h1 { font-size: 1.1em; font-weight: 600; margin: .2em 0; color: var(--dim) }
h2 { font-size: 1.15em; margin: 0 0 .2em }
.pass, .identical, .good { color: var(--good) } .fail, .bad { color: var(--bad) }
.lead .good { color: inherit }
.note { color: var(--dim); max-width: 48em; margin: .4em 0 } .fail { margin: .2em 0 }
.lead { font-size: 1.35em; line-height: 1.4; margin: .3em 0 .6em; max-width: 44em }
nav { margin: 1em 0 } nav a { margin-right: .9em; white-space: nowrap; color: var(--focus) }
.panel, section { background: var(--panel); border: 1px solid var(--line); border-radius: 8px; padding: .9em 1.1em;
  margin: 0 0 .9em }
.looks { display: grid; grid-template-columns: minmax(0, 1fr) minmax(0, 17em); gap: 1em; align-items: start }
.looks .closer { display: grid; gap: 1em } .looks figcaption { color: var(--dim); font-size: .85em; margin-top: .3em }
.looks:not(:has(.closer)) { grid-template-columns: minmax(0, 1fr) }
.figures { display: grid; gap: 1em; align-items: start;
  grid-template-columns: repeat(auto-fit, minmax(min(100%, 20em), 1fr)) }
figure { margin: 0; min-width: 0; max-width: 34em } .looks figure { max-width: none }
figure svg { display: block; width: 100%; height: auto; fill: var(--text) }
.wide { overflow-x: auto; margin-bottom: 1em } .wide:last-child { margin-bottom: 0 }
.fail + .panel { margin-top: .8em }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; font-size: .92em }
td, th { padding: .25em .7em; text-align: right; border-bottom: 1px solid var(--line); white-space: nowrap }
th { font-weight: 500; color: var(--dim) } tr:last-child td { border-bottom: 0 }
td:first-child, th:first-child, #valid td:last-child, #valid th:last-child { text-align: left }
td:first-child, th:first-child { position: sticky; left: 0; background: var(--panel); padding-left: 0 }
#ends td:first-child { font-weight: 600 }
details { margin: 0 0 .5em } summary { cursor: pointer; padding: .4em .2em; font-weight: 600 }
summary:hover { color: var(--focus) } details[open] > summary { margin-bottom: .3em }
:focus-visible { outline: 3px solid var(--focus); outline-offset: 2px }
section { scroll-margin-top: 3em }
@media (max-width: 44em) { .looks { grid-template-columns: minmax(0, 1fr) } .looks .closer { max-width: 20em } }
@media (max-width: 30em) { body { padding: .5em } .lead { font-size: 1.15em } .panel, section { padding: .7em }
  td, th { padding: .2em .45em; font-size: .9em } th { white-space: normal } }
@page { margin: 15mm }
@media print {
  body { max-width: none; padding: 0; font-size: 10pt; background: none } nav { display: none }
  .panel, section { border: 0; padding: 0 } figure, tr, .lead { break-inside: avoid } h2, summary { break-after: avoid }
  details::details-content { content-visibility: visible; display: block } summary { list-style: none }
  .wide { overflow: visible } td, th { white-space: normal; padding: .15em .4em; position: static }
  .figures { grid-template-columns: 1fr 1fr }
}
"""
)

PAGE = (
    """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<title>{{ title }}</title>
<style>"""
    + STYLE
    + """</style>
</head>
<body>
{% macro rows(table) %}<div class="wide"><table>
<tr>{% for cell in table.rows[0] %}<th>{{ cell }}</th>{% endfor %}</tr>
{% for row in table.rows[1:] %}<tr>{% for cell in row %}<td>{{ cell }}</td>{% endfor %}</tr>
{% endfor %}</table></div>{% endmacro %}
{% macro body(section) %}<section id="{{ section.id }}">
{% if not section.folded %}<h2>{{ section.title }}</h2>
{% endif %}<p class="note">{{ section.note }}</p>
{% for table in section.tables %}
<p class="note">{{ table.about }}</p>
{{ rows(table) }}
{% endfor %}
{% if section.figures %}<div class="figures">
{% for figure in section.figures %}<figure>{{ figure }}</figure>
{% endfor %}</div>{% endif %}
</section>{% endmacro %}
<h1>{{ title }}{% if verdict %}: <span class="{{ verdict }}">{{ verdict }}</span>{% endif %}</h1>
{% if lead %}<p class="lead">
{%- for part in lead.said %}<span class="{{ part.kind }}">{{ part.text }}</span>
{%- endfor %}</p>
{% endif %}{% for reason in reasons %}<p class="fail">{{ reason }}</p>
{% endfor %}{% if lead %}<div class="panel"><div class="looks">
{% for look in lead.looks[:1] %}<figure class="tank">{{ look.svg }}<figcaption>{{ look.caption }}</figcaption></figure>
{% endfor %}{% if lead.looks[1:] %}<div class="closer">
{% for look in lead.looks[1:] %}<figure>{{ look.svg }}<figcaption>{{ look.caption }}</figcaption></figure>
{% endfor %}</div>{% endif %}</div></div>
{% if lead.ends.rows[1:] %}<section id="ends"><p class="note">{{ lead.ends.about }}</p>
{{ rows(lead.ends) }}</section>
{% endif %}{% endif %}<p class="note">{{ about }}</p>
<nav>{% for section in sections %}<a href="#{{ section.id }}">{{ section.title }}</a> {% endfor %}</nav>
{% for section in sections if not section.folded %}{{ body(section) }}
{% endfor %}{% for section in sections if section.folded %}<details><summary>{{ section.title }}</summary>
{{ body(section) }}</details>
{% endfor %}</body>
</html>
"""
)

Row = list[str]


class Table(NamedTuple):
    about: str  # what to see in it, one sentence
    rows: list[Row]  # its head first


class Section(NamedTuple):
    id: str
    title: str
    note: str
    tables: list[Table]
    figures: list[Markup]
    folded: bool = True  # what experts want


def svg(figure: Figure) -> Markup:
    """The figure as an element of the page, in the page's colours, which are light or dark."""
    text = io.StringIO()
    with matplotlib.rc_context(
        {"svg.fonttype": "none", "svg.hashsalt": "aucamp"}
    ):  # text stays text; same ids each time
        FigureCanvasSVG(figure).print_svg(text, metadata={"Date": None})  # type: ignore[no-untyped-call]
    svg = text.getvalue()[text.getvalue().index("<svg") :]
    svg = re.sub(r' (width|height)="[\d.]+pt"', "", svg, count=2)  # its box decides how large it is
    return Markup(re.sub(r"(fill|stroke): (#[0-9a-f]{6})", _themed, svg))


def _themed(found: re.Match[str]) -> str:
    name = THEMED.get(found[2])
    return found[0] if name is None else f"{found[1]}: var(--{name}, {found[2]})"
