"""How pages read: no sentence that needs a second reading, and none of the words that nobody says.

Prose is what stands in paragraphs and lists. Tables, code and what programs write are looked at by others.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.places import ROOT

MOST_WORDS = 35  # of a sentence
MOST_IN_THE_MEAN = 18.0  # of a page's
FEW = 10  # sentences: fewer have no mean to speak of
UNSAID = re.compile(r"\b(whoever|whosever|for so(?! long)|of late)\b", re.IGNORECASE)
WRITTEN_BY_PROGRAMS = ("docs/research/", "docs/messages.md")
PAGES = [
    path.relative_to(ROOT).as_posix()
    for folder in (".", "docs", "agent/perception/enhancement/weights", "hw", "replay", "router_config")
    for path in sorted((ROOT / folder).glob("*.md"))
    if not path.relative_to(ROOT).as_posix().startswith(WRITTEN_BY_PROGRAMS)
]
APART = ("#", "|", "![")  # how lines begin that are no prose
ITEM = re.compile(r"^([*-]|\d+\.)\s+")


def paragraphs(text: str) -> Iterator[str]:
    """Of a page, without its code blocks; an item of a list is one."""
    lines: list[str] = []
    for raw in [*re.sub(r"```.*?```", "\n\n", text, flags=re.DOTALL).splitlines(), ""]:
        line = raw.strip()
        if not line or line.startswith(APART) or raw.startswith("    ") or ITEM.match(line):
            yield " ".join(lines)
            lines = []
        if line and not line.startswith(APART) and not raw.startswith("    "):
            lines.append(ITEM.sub("", line, count=1))


def sentences(text: str) -> list[tuple[int, str]]:
    """Words, and the sentence. What stands in backticks is one word."""
    found = []
    for paragraph in paragraphs(text):
        plain = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", re.sub(r"`[^`]*`", "code", paragraph))
        for sentence in re.split(r"(?<=[.!?:;])\s+", plain):
            if words := len(re.findall(r"[\w'/-]+", sentence)):
                found.append((words, sentence))
    return found


@pytest.mark.parametrize("page", PAGES)
def test_a_page_is_understood_at_the_first_reading(page: str) -> None:
    text = Path(ROOT / page).read_text(encoding="utf-8")
    found = sentences(text)
    assert not [sentence for words, sentence in found if words > MOST_WORDS]
    assert not UNSAID.findall(text)
    if len(found) >= FEW:
        assert sum(words for words, _ in found) / len(found) <= MOST_IN_THE_MEAN


def test_generated_pages_have_no_endless_sentence_and_no_word_that_nobody_says() -> None:
    """Their texts come from the registry of claims and from the messages."""
    pages = [path for path in (ROOT / "docs").rglob("*.md") if path.relative_to(ROOT).as_posix() not in PAGES]
    assert len(pages) > 30
    texts = {path.name: path.read_text(encoding="utf-8") for path in pages}
    assert not [(name, sentence) for name in texts for words, sentence in sentences(texts[name]) if words > MOST_WORDS]
    assert not [(name, word) for name, text in texts.items() for word in UNSAID.findall(text)]


def test_sentences_are_counted_as_people_read_them() -> None:
    text = "# Title of a page\n\nOne `two three` four. Five [six](seven.md)\neight:\n\n* nine ten\n\n| a | table |\n"
    assert [words for words, _ in sentences(text)] == [3, 3, 2]
