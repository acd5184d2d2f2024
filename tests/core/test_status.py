"""The log does not flood, and says what it left out."""

from agent.core.status import AGAIN_NS, SELDOM_NS, Logbook

STEP_NS = 50_000_000


def test_the_same_line_comes_once_a_second_and_the_rest_is_counted() -> None:
    book, lines = Logbook("r1"), []
    for step in range(50):  # 2.5 s, a line with each step
        book.note("warning", "no frames", step * STEP_NS)
        lines += book.fetch(step * STEP_NS)
    assert [line.text for line in lines] == ["no frames", *["no frames (20 times more in 1.0 s)"] * 2]
    assert {line.level for line in lines} == {"warning"}
    lines = [line for step in range(50, 100) for line in book.fetch(step * STEP_NS)]
    assert [line.text for line in lines] == ["no frames (9 times more in 1.0 s)"], "what was held back is not lost"


def test_different_lines_pass_and_a_line_is_news_again_after_a_second() -> None:
    book = Logbook("r1")
    book.note("info", "a", 0)
    book.note("info", "b", 0)
    assert [line.text for line in book.fetch(0)] == ["a", "b"]
    assert book.fetch(AGAIN_NS) == ()
    book.note("info", "a", AGAIN_NS)
    assert [line.text for line in book.fetch(AGAIN_NS)] == ["a"]


def test_one_line_held_back_comes_as_it_is_and_a_long_one_keeps_its_count() -> None:
    book = Logbook("r1")
    for text in ("once", *["x" * 500] * 3, "once"):
        book.note("info", text, 0)
    book.fetch(0)
    once, long = book.fetch(AGAIN_NS)
    assert once.text == "once"
    assert long.text.endswith("x (2 times more in 1.0 s)")
    assert len(long.text) == 400


def test_a_subject_has_a_line_in_five_seconds_whatever_the_text() -> None:
    book, lines = Logbook("r1"), []
    for k in range(11):
        book.note_seldom("warning", "garbage", f"refused, {k} so far", k * 10**9)
        lines += book.fetch(k * 10**9)
    assert [line.sent_ns for line in lines] == [0, SELDOM_NS + 10**9]
