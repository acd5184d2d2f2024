"""The camera socket: its bytes, one client at a time, and every way in which either side can fail the other."""

import contextlib
import socket
import stat
import threading

import pytest

from hw.camera import frame_socket
from hw.camera.camera import CameraError, CameraGone, Roi
from hw.camera.frame_socket import (
    FULL,
    INFO,
    READ,
    REPLY_SIZE,
    REQUEST_SIZE,
    SET_FOCUS,
    FrameServer,
    Reply,
    Request,
    Torn,
    open_twin,
    pack_reply,
    pack_request,
    parse_reply,
    parse_request,
)

REQUEST = Request(READ, 7, -3, 50_000, Roi(8, 16, 320, 240))
REPLY = Reply(frame_socket.OK, 7, 12, 345_678_901_234, Roi(8, 16, 320, 240), 230_400)


@pytest.fixture
def server(tmp_path, source):
    server = FrameServer(tmp_path / "r1.camera", source)
    server.start()
    yield server
    source.gate.set()
    server.close()


@pytest.fixture
def raw(server):
    """A client that says what it likes."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
        connection.settimeout(10)
        connection.connect(str(server.path))
        yield connection


def receive(connection, count):
    data = b""
    while len(data) < count:
        part = connection.recv(count - len(data))
        assert part, "the server hung up"
        data += part
    return data


def ask(connection, request):
    connection.sendall(pack_request(request))
    header = receive(connection, REPLY_SIZE)
    return header, receive(connection, parse_reply(header).nbytes)


class Liar(threading.Thread):
    """A server that gives one prepared answer."""

    def __init__(self, listener, answer):
        super().__init__()
        self.listener, self.answer = listener, answer

    def run(self):
        connection, _ = self.listener.accept()
        with connection:
            connection.settimeout(10)
            receive(connection, REQUEST_SIZE)
            connection.sendall(self.answer)


class TestHeaders:
    def test_round_trip(self):
        assert parse_request(pack_request(REQUEST)) == REQUEST
        assert parse_reply(pack_reply(REPLY)) == REPLY
        assert (len(pack_request(REQUEST)), len(pack_reply(REPLY))) == (REQUEST_SIZE, REPLY_SIZE)

    @pytest.mark.parametrize(
        ("packed", "parse"), [(pack_request(REQUEST), parse_request), (pack_reply(REPLY), parse_reply)]
    )
    def test_a_flipped_bit_is_noticed(self, packed, parse):
        for bit in range(8 * len(packed)):
            torn = bytearray(packed)
            torn[bit // 8] ^= 1 << bit % 8
            with pytest.raises(Torn):
                parse(bytes(torn))

    def test_a_payload_beyond_the_limit_is_refused(self):
        parse_reply(pack_reply(REPLY._replace(nbytes=64 << 20)))
        with pytest.raises(Torn, match="limit"):
            parse_reply(pack_reply(REPLY._replace(nbytes=(64 << 20) + 1)))


class TestServer:
    def test_settle_time_and_region_reach_the_source(self, server, source, closing):
        camera = closing(open_twin(server.path))
        camera.read(Roi(8, 8, 16, 16), settle_s=0.05)
        camera.read()
        assert source.settles_s == pytest.approx([0.05, 0.0])
        assert source.rois == [Roi(8, 8, 16, 16), None]

    def test_only_the_own_user_may_connect(self, server):
        assert stat.S_IMODE(server.path.stat().st_mode) == 0o600

    def test_nothing_tells_where_the_lens_is(self, raw, source):
        answers = []
        for lens_position in (0, 20):
            ask(raw, Request(SET_FOCUS, 1, lens_position=lens_position))
            source.lens_position = 4  # what is in the picture stays the same
            header, pixels = ask(raw, Request(READ, 2))
            answers.append((parse_reply(header)._replace(seq=0, t_ns=0), pixels))
        assert answers[0] == answers[1]

    def test_unknown_verb_is_answered_and_the_next_request_served(self, raw):
        header, text = ask(raw, Request(99, 5))
        assert (parse_reply(header).status, parse_reply(header).id) == (frame_socket.UNKNOWN_VERB, 5)
        assert text == b"unknown verb 99"
        header, _ = ask(raw, Request(INFO, 6))
        assert parse_reply(header).status == frame_socket.OK

    def test_after_garbage_the_server_says_why_and_hangs_up(self, raw):
        raw.sendall(b"GET / HTTP/1.1\r\nHost: twin\r\n\r\n".ljust(REQUEST_SIZE))
        reply = parse_reply(receive(raw, REPLY_SIZE))
        assert reply.status == frame_socket.TORN
        assert b"AUC1" in receive(raw, reply.nbytes)
        assert raw.recv(1) == b""

    @pytest.mark.parametrize("roi", [Roi(0, 0, 97, 8), Roi(0, 60, 8, 8), Roi(0, 0, 0, 8), Roi(65535, 0, 8, 8)])
    def test_a_region_outside_never_reaches_the_source(self, raw, source, roi):
        header, text = ask(raw, Request(READ, 1, roi=roi))
        assert parse_reply(header).status == frame_socket.FAILED and b"not inside 96x64" in text
        assert source.rois == []

    def test_a_second_client_is_refused_and_the_first_served_on(self, server, closing):
        first = closing(open_twin(server.path))
        with pytest.raises(CameraError, match="in use"):
            open_twin(server.path)
        assert first.read().roi.width == 96

    def test_the_next_client_is_served_when_the_first_has_left(self, server):
        for _ in range(20):
            camera = open_twin(server.path)
            camera.read()
            camera.close()

    def test_a_client_that_stops_in_mid_request_is_dropped(self, monkeypatch, raw, server, closing):
        monkeypatch.setattr(frame_socket, "STALL_S", 0.05)
        raw.sendall(pack_request(REQUEST)[:5])
        assert raw.recv(1) == b""
        assert closing(open_twin(server.path)).read().seq == 1

    def test_a_client_that_does_not_read_its_frame_is_dropped(self, monkeypatch, raw, server, closing):
        monkeypatch.setattr(frame_socket, "STALL_S", 0.05)
        raw.sendall(b"".join(pack_request(Request(READ, n)) for n in range(100)))  # 1.8 MB of answers
        camera = None
        while camera is None:
            try:
                camera = closing(open_twin(server.path))
            except CameraError:  # still served
                continue
        assert camera.read().image.shape == (64, 96, 3)

    def test_what_the_source_refuses_the_client_hears(self, server, source, closing):
        camera = closing(open_twin(server.path))
        source.fault = "the lens is stuck"
        with pytest.raises(CameraError, match="the lens is stuck"):
            camera.read()
        source.fault = None
        assert camera.read().seq == 1

    def test_close_hangs_up_and_leaves_nothing(self, server):
        camera = open_twin(server.path)
        thread = server._thread
        server.close()
        assert not thread.is_alive() and not server.path.exists()
        with pytest.raises(CameraGone, match="hung up"):
            camera.read()

    def test_close_while_a_client_stalls(self, server, raw):
        raw.sendall(b"AUC1")
        server.close()
        with contextlib.suppress(ConnectionResetError):  # what was not read makes it a reset
            assert raw.recv(1) == b""

    def test_a_socket_that_was_left_behind_is_replaced(self, tmp_path, source, closing):
        path = tmp_path / "r1.camera"
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as dead:
            dead.bind(str(path))
        server = FrameServer(path, source)
        server.start()
        closing(server)
        assert closing(open_twin(path)).size == (96, 64)

    def test_a_file_of_another_kind_is_left_alone(self, tmp_path, source):
        path = tmp_path / "r1.camera"
        path.write_text("notes")
        with pytest.raises(CameraError, match="no socket"):
            FrameServer(path, source).start()
        assert path.read_text() == "notes"

    def test_a_path_that_cannot_be_served_is_one_line(self, tmp_path, source):
        for path in (tmp_path / "none" / "r1.camera", tmp_path / ("x" * 120)):
            with pytest.raises(CameraError, match="cannot serve") as caught:
                FrameServer(path, source).start()
            assert "\n" not in str(caught.value)


class TestClient:
    def test_no_frame_in_time(self, server, source, closing):
        camera = closing(open_twin(server.path))
        source.gate.clear()
        with pytest.raises(CameraGone, match=r"no answer within 0\.05 s"):
            camera.read(timeout_s=0.05)
        source.gate.set()
        with pytest.raises(CameraGone):  # never a late frame as the answer to a later question
            camera.read()
        assert closing(open_twin(server.path)).read().image.shape == (64, 96, 3)

    def test_a_machine_that_is_busy_for_a_second_loses_no_frame(self, server, source, closing):
        camera = closing(open_twin(server.path))
        source.gate.clear()
        busy = threading.Timer(1.1, source.gate.set)
        busy.start()
        assert camera.read().image.shape == (64, 96, 3)
        busy.join()

    @pytest.mark.parametrize(
        "answer",
        [
            b"HTTP/1.1 400 Bad Request".ljust(REPLY_SIZE),
            pack_reply(Reply(frame_socket.OK, 1, nbytes=4)) + b"four",  # INFO has more to say
            pack_reply(Reply(frame_socket.OK, 55, nbytes=16)) + bytes(16),
            pack_reply(Reply(frame_socket.OK, 1, nbytes=16)) + bytes(3),
        ],
        ids=["another protocol", "short payload", "another's answer", "end in the middle"],
    )
    def test_an_answer_that_makes_no_sense(self, tmp_path, answer):
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as listener:
            listener.bind(str(tmp_path / "odd"))
            listener.listen()
            listener.settimeout(10)
            liar = Liar(listener, answer)
            liar.start()
            with pytest.raises(CameraGone):
                open_twin(tmp_path / "odd")
            liar.join()

    def test_the_whole_frame_and_no_region_are_one_request(self):
        assert parse_request(pack_request(Request(READ, 1))).roi == FULL
