"""One message of a key is on its way to a page; what it has not drawn in time it never gets."""

import json

from agent.core.codec import Refusal
from agent.ground.page.rows import KEPT, MOST_KEYS, Board, Viewer, text


def shows(board: Board, key: str, value: int) -> None:
    board.show(key, lambda: text({"k": key, "value": value}))


def sent(board: Board, viewer: Viewer) -> list[tuple[str, int | None]]:
    """All that goes to a page which acknowledges nothing."""
    return [(fields["k"], fields.get("value")) for fields in map(json.loads, board.next_for(viewer))]


def test_a_page_that_does_not_answer_gets_one_message_of_each_key_and_then_the_newest() -> None:
    board = Board()
    viewer = board.join()
    for value in range(50):
        shows(board, "state/r1", value)
        shows(board, "state/r2", value)
        if value == 0:
            assert sent(board, viewer) == [("state/r1", 0), ("state/r2", 0)]
    assert sent(board, viewer) == []
    viewer.got(["state/r1"])
    assert sent(board, viewer) == [("state/r1", 49)]
    viewer.got(["state/r1"])
    assert sent(board, viewer) == [], "what it has it does not get again"


def test_every_page_goes_at_its_own_pace_and_a_message_is_made_once() -> None:
    board, made = Board(), []
    fast, slow = board.join(), board.join()

    def make() -> str:
        made.append(1)
        return text({"k": "a"})

    board.show("a", make)
    assert sent(board, fast) == sent(board, slow) == [("a", None)]
    assert len(made) == 1
    shows(board, "a", 2)
    fast.got(["a"])
    assert sent(board, fast) == [("a", 2)] and sent(board, slow) == []


def test_nothing_is_made_for_nobody() -> None:
    board = Board()

    def make() -> str:
        raise AssertionError("nobody looks")

    for _ in range(5):
        board.show("a", make)


def test_lines_are_a_queue_that_forgets_the_oldest() -> None:
    board = Board()
    viewer = board.join()
    for number in range(KEPT + 10):
        board.say(text({"k": "log/r1", "n": number}))
    message = json.loads(board.next_for(viewer)[0])
    assert [line["n"] for line in message["lines"]] == list(range(10, KEPT + 10))
    board.say(text({"k": "log/r1", "n": -1}))
    assert board.next_for(viewer) == []
    viewer.got(["lines"])
    assert [line["n"] for line in json.loads(board.next_for(viewer)[0])["lines"]] == [-1]


def test_who_comes_later_sees_what_is_there() -> None:
    board = Board()
    shows(board, "state/r1", 1)
    board.say(text({"k": "log/r1", "n": 5}))
    assert [key for key, _ in sent(board, board.join())] == ["state/r1", "lines"]


def test_what_is_no_message_is_counted_and_the_rest_is_shown() -> None:
    board = Board()
    viewer = board.join()

    def refuse() -> str:
        raise Refusal("garbage", "not msgpack")

    board.show("state/r1", refuse)
    shows(board, "state/r2", 2)
    assert sent(board, viewer) == [("state/r2", 2)] and board.refused == 1
    shows(board, "state/r1", 3)
    assert sent(board, viewer) == [("state/r1", 3)]


def test_who_invents_keys_fills_nothing() -> None:
    board = Board()
    viewer = board.join()
    for number in range(MOST_KEYS + 100):
        shows(board, f"state/{number}", number)
    assert len(sent(board, viewer)) == MOST_KEYS


def test_another_time_of_a_recording_begins_with_saying_so() -> None:
    board = Board()
    shows(board, "hello", 0)
    viewer = board.join()
    shows(board, "state/r1", 1)
    sent(board, viewer)
    shows(board, "state/r1", 2)  # waits
    board.start_over()
    shows(board, "state/r1", 3)
    assert sent(board, viewer) == [("over", None), ("state/r1", 3)]
    assert next(key for key, _ in sent(board, board.join())) == "hello"
