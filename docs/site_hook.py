"""What mkdocs is told beyond mkdocs.yml, so that one text reads well on a site and as plain files.

Pages that lie outside docs/ join the site under their own path, and all links are led to where pages lie there. A link
to a folder leads to a list of its files. Markdown that mkdocs reads otherwise than others do is written its way. At its
first use on a page a term of the glossary leads there, and shows what it means.
"""

from __future__ import annotations

import posixpath
import re
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
OUTSIDE = (
    "CONTRIBUTING.md",
    "agent/perception/enhancement/weights/README.md",
    "agent/reconstruction/viewer/README.md",
    "hw/README.md",
    "replay/README.md",
    "router_config/README.md",
)
GLOSSARY = "concepts.md"
UNEXPLAINED = (
    "README.md",
    "concepts.md",
    "architecture.md",
    "messages.md",
    "research/",
)  # for those who know the terms
LISTED = ("research/results", "schemas")  # folders of docs/ that pages link to
LINK = re.compile(r"(?<=\]\()([^)\s#]*)((?:#[^)\s]*)?)(?=\))")
ITEM = re.compile(r"(?:[*-]|\d+\.) ")
NO_PROSE = re.compile(
    r"```.*?```|^(?:#| {4}).*?$|`[^`\n]*`|!?\[[^\]]*\]\([^)]*\)|https?://\S+", re.DOTALL | re.MULTILINE
)


def on_config(config: Any) -> Any:
    config.mdx_configs["toc"]["slugify"] = slug
    return config


def slug(heading: str, _separator: str = "-") -> str:
    """The anchor of a heading, as sites that show Markdown make it."""
    return re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")


def on_files(files: Any, config: Any) -> Any:
    from mkdocs.structure.files import File, InclusionLevel

    for path in OUTSIDE:
        files.append(File.generated(config, path, abs_src_path=str(ROOT / path)))
    for folder in LISTED:
        names = sorted(path.name for path in (ROOT / "docs" / folder).iterdir() if path.is_file())
        text = "\n".join([f"# Files in docs/{folder}", "", *(f"* [{name}]({name})" for name in names), ""])
        files.append(File.generated(config, f"{folder}/index.md", content=text, inclusion=InclusionLevel.NOT_IN_NAV))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    return respelled(explained(relinked(markdown, page.file.src_uri), page.file.src_uri))


def relinked(markdown: str, page: str) -> str:
    """With every link between pages led from file to file of the site; `page` is the site's name of this one."""
    here = posixpath.dirname(page if page in OUTSIDE else f"docs/{page}")

    def led(link: re.Match[str]) -> str:
        path, anchor = link.groups()
        if not path or "://" in path:
            return link[0]
        there = posixpath.normpath(posixpath.join(here, path))
        there = there.removeprefix("docs/") if there.startswith("docs/") else there
        there = f"{there}/index.md" if there in LISTED else there
        return posixpath.relpath(there, posixpath.dirname(page) or ".") + anchor

    return LINK.sub(led, markdown)


def glossary() -> dict[str, str]:
    """Each term, and what it means in plain text. A row of several words explains none of them alone."""
    table = (ROOT / "docs" / GLOSSARY).read_text(encoding="utf-8").partition("## Glossary")[2]
    rows = re.findall(r"^\| ([^|]+) \| ([^|]+) \|$", table, re.MULTILINE)
    return {term: meaning.replace("`", "") for term, meaning in rows if term != "term" and "," not in term}


def explained(markdown: str, page: str) -> str:
    """With the first use of each term led to the glossary. Headings, code and links stay as they are."""
    if page.startswith(UNEXPLAINED):
        return markdown
    meanings = glossary()
    there = posixpath.relpath(GLOSSARY, posixpath.dirname(page) or ".") + "#glossary"
    words = "|".join(re.escape(term) for term in sorted(meanings, key=len, reverse=True))
    term_or_not = re.compile(rf"(?P<apart>{NO_PROSE.pattern})|\b(?P<term>{words})s?\b", NO_PROSE.flags | re.IGNORECASE)

    def led(found: re.Match[str]) -> str:
        meaning = meanings.pop(found["term"].lower(), None) if found["term"] else None
        return found[0] if meaning is None else f'[{found[0]}]({there} "{meaning}")'

    return term_or_not.sub(led, markdown)


def respelled(markdown: str) -> str:
    """A list may follow its paragraph without a blank line, its items may be indented by three, and the name of a file
    may stand behind the language of a block. A bar inside code needs no backslash in a table."""
    lines, fence, before, begun = [], None, "", ""  # begun: how the paragraph begins that a line is of
    for raw in markdown.splitlines():
        line, mark = raw, raw.lstrip()
        indent = len(raw) - len(mark)
        if mark.startswith("```"):
            if fence is None:
                line = re.sub(r"^(\s*```\w+) (\S+)$", r'\1 title="\2"', raw)
            line = " " + line if indent == 3 else line
            fence = indent if fence is None else None
        elif fence is not None:
            line = " " + raw if fence == 3 and mark else raw
        elif indent == 3:
            line = " " + raw
        elif mark.startswith("|"):
            line = re.sub(r"`[^`]*`", lambda code: code[0].replace("\\|", "|"), raw)
        elif ITEM.match(raw) and before.strip() and not ITEM.match(begun):
            lines.append("")
        lines.append(line)
        begun = raw if not before.strip() or ITEM.match(raw) else begun
        before = raw
    return "\n".join(lines) + "\n"
