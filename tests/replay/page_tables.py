"""The tables of a report's page, for tests."""

import html
import re


def table(page: str, section: str, number: int = 0) -> list[list[str]]:
    """The cells of a table of the page, by rows."""
    part = page[page.index(f'<section id="{section}">') :]
    found = re.findall(r"<table>.*?</table>", part, re.DOTALL)[number]
    rows = re.findall(r"<tr>.*?</tr>", found, re.DOTALL)
    return [[html.unescape(cell) for cell in re.findall(r"<t[dh]>(.*?)</t[dh]>", row)] for row in rows]
