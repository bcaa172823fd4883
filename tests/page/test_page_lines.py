"""Readings that arrive at the page as lines: of a port, a file, a folder."""

import io
import queue
import socket
import sys
import threading
import time
import types
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from page.page_server import rows
from pkm_page import feed, show
from pkm_page.feed import Feed, LineBuffer, Offer
from pkm_page.rows import clean_remark
from pkm_studies.base import InputError


@pytest.mark.parametrize(
    ("pattern", "line", "values"),
    [
        (r"(?P<length_um>[-+]?\d+\.\d+)", "01A+00012.34\r", {"length": 12.34e-6}),
        (r"^\S+,(?P<read_x_mm>[^,]+),(?P<read_y_mm>[^,]+)", "P1, 1.5,-2", {"read_x": 1.5e-3, "read_y": -2e-3}),
        (r"R=(?P<length_mm>[-\d,]+)", "R=300,125 ok", {"length": 0.300125}),
        (r"R=(?P<length_mm>[-\d.]+)", "no reading", None),
        (r"R=(?P<length_mm>\S+)", "R=abc", None)
    ],
)  # fmt: skip
def test_a_line_becomes_numbers(tmp_path, pattern, line, values):
    offers: list[Offer] = []
    Feed(str(tmp_path), pattern, offers.append).take_line(line)
    assert [offer.values for offer in offers] == (
        [] if values is None else [pytest.approx(values)]
    )


@pytest.mark.parametrize(
    ("source", "pattern"),
    [("absent.csv", ""), ("tcp://nowhere", "(?P<a_mm>.)"), ("tcp://h:1", ""), (".", "(?P<length>.)"),
     (".", "("), (".", "no group")],
)  # fmt: skip
def test_what_no_line_can_be_is_refused(source, pattern):
    with pytest.raises(InputError):
        Feed(source, pattern, lambda _: None)


def test_readings_arrive_by_tcp(machine):
    """A gauge that sends a line: the entry shows it, and the page takes it at once."""
    opened, client, operator = machine
    gauge = socket.create_server(("127.0.0.1", 0))
    source = f"tcp://127.0.0.1:{gauge.getsockname()[1]}"
    opened.feed = Feed(source, r"L (?P<length_mm>[-\d.]+)", opened.arrived)
    opened.feed.start()
    line, _ = gauge.accept()
    try:
        entry = operator.display()
        line.sendall(f"...12.3\nL {entry[0]}\n".encode())
        wait(lambda: client.state()["offer"])
        assert [float(e) for e in client.state()["offer"]["entries"]] == pytest.approx(
            [float(entry[0])]
        )
        opened.take_at_once = True
        line.sendall(f"noise\nL {entry[0]}\n".encode())
        wait(lambda: opened.session.log.path.exists())
        wait(lambda: "Reading 2 of" in client.state()["parts"]["pose"])
        line.sendall(b"L 12.0\n")
        wait(lambda: client.state()["doubt"])
        assert "should lie between" in client.state()["doubt"]
        assert len(rows(opened.session.log.path)) == 1
    finally:
        line.close()
        gauge.close()
        opened.feed, opened.take_at_once = None, False
        opened.offer, opened.doubt = None, ""


def test_a_file_that_grows_is_followed(tmp_path):
    path = tmp_path / "gauge.csv"
    path.write_text("no;length_mm\n1;300.1\n", encoding="utf-8")
    offers: list[Offer] = []
    Feed(str(path), "", offers.append).start()
    time.sleep(0.2)
    with path.open("a", encoding="utf-8") as file:
        file.write("2;300,2\n3;3")
    wait(lambda: offers)
    assert offers[0].values == pytest.approx({"length": 0.3002})


def lines_of(source: Iterator[str]) -> queue.Queue[str]:
    """Lines of a source, as they come in a thread."""
    lines: queue.Queue[str] = queue.Queue()

    def follow() -> None:
        for line in source:
            lines.put(line)

    threading.Thread(target=follow, daemon=True).start()
    return lines


def test_a_line_counts_where_its_beginning_and_its_end_were_seen():
    """However the bytes are cut: `900.2` of `900.2903` and `9.1234` of `1799.1234`."""
    sent = b"99.1234\r\n1799.1234\n900.2903\r900.2"
    for size in range(1, len(sent)):
        parts = [sent[k : k + size] for k in range(0, len(sent), size)]
        joined, begun = LineBuffer(begins=False), LineBuffer(begins=True)
        assert [x for p in parts for x in joined.add(p)] == ["1799.1234", "900.2903"]
        assert next(x for p in parts for x in begun.add(p)) == "99.1234"


def test_a_lost_connection_leaves_no_half_line():
    gauge = socket.create_server(("127.0.0.1", 0))
    feed_lines = feed._tcp_lines(("127.0.0.1", gauge.getsockname()[1]))
    lines = lines_of(feed_lines)
    line, _ = gauge.accept()
    line.sendall(b"9.1234\n1800.5\n900.2")
    assert lines.get(timeout=10.0) == "1800.5"
    line.close()
    gauge.close()
    time.sleep(0.2)
    assert lines.empty()


def test_a_serial_line_is_joined_in_the_midst(monkeypatch):
    class Port(io.BytesIO):
        in_waiting = 3

    port = Port(b"9.1234\r\n1800.5\r\n900.2")
    module = types.ModuleType("serial")
    monkeypatch.setattr(module, "Serial", lambda device, baud: port, raising=False)
    monkeypatch.setitem(sys.modules, "serial", module)
    assert [*feed._serial_lines("/dev/none", 9600)] == ["1800.5"]


def test_a_line_that_was_half_written_at_the_start_does_not_count(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(feed, "PAUSE", 0.01)
    path = tmp_path / "gauge.txt"
    path.write_text("1700.5\n179", encoding="utf-8")
    source = feed._file_lines(path, is_table=False)
    lines = lines_of(source)
    time.sleep(0.1)
    for text in ("9.1234\n18", "00.5\n900.2"):
        with path.open("a", encoding="utf-8") as file:
            file.write(text)
        time.sleep(0.1)
    assert lines.get(timeout=10.0) == "1800.5"
    assert lines.empty()


def test_a_file_that_takes_another_s_place_gives_no_half_line(tmp_path, monkeypatch):
    monkeypatch.setattr(feed, "PAUSE", 0.01)
    path = tmp_path / "gauge.txt"
    path.write_text("1.5\n", encoding="utf-8")
    lines = lines_of(feed._file_lines(path, is_table=False))
    time.sleep(0.1)
    path.write_text("1799.1234\n1800.5\n", encoding="utf-8")
    assert lines.get(timeout=10.0) == "1800.5"


def test_a_long_file_is_read_to_its_end(tmp_path, monkeypatch):
    """Parts as small as here never end a line by themselves."""
    monkeypatch.setattr(feed, "PAUSE", 0.001)
    monkeypatch.setattr(feed, "MAX_STREAM_BYTES", 64)
    path = tmp_path / "gauge.csv"
    old = "no;length_mm\n" + "".join(f"{k};300.{k}\n" for k in range(500))
    path.write_text(old, encoding="utf-8")
    lines = lines_of(feed._file_lines(path, is_table=True))
    time.sleep(0.1)
    with path.open("a", encoding="utf-8") as file:
        file.write("".join(f"{k};301.{k}\n" for k in range(40)))
    got = [lines.get(timeout=10.0) for _ in range(40)]
    assert got == [f"no;length_mm\n{k};301.{k}" for k in range(40)]


def test_a_line_that_is_too_long_is_passed_over_and_said(tmp_path, monkeypatch):
    """No part of it is a line of its own, and the next one counts."""
    monkeypatch.setattr(feed, "MAX_STREAM_BYTES", 3 * feed.MAX_LINE_BYTES)
    monkeypatch.setattr(feed, "PAUSE", 0.001)
    offers: list[Offer] = []
    path = tmp_path / "gauge.txt"
    path.touch()
    followed = Feed(str(path), r"^L (?P<length_mm>[\d.]+)", offers.append)
    followed.start()
    time.sleep(0.1)
    long = "L 1.5" + "9" * 4 * feed.MAX_LINE_BYTES + "\nL 300"
    with path.open("a", encoding="utf-8") as file:
        file.write(long)
    wait(lambda: followed.problem)
    assert f"more than {feed.MAX_LINE_BYTES} bytes" in followed.problem
    with path.open("a", encoding="utf-8") as file:
        file.write(".5\n")
    wait(lambda: offers)
    assert [offer.values for offer in offers] == [{"length": pytest.approx(0.3005)}]
    assert followed.problem == ""


def test_a_remark_that_is_too_long_is_refused():
    assert clean_remark("warm\n spindle") == "warm spindle"
    with pytest.raises(InputError, match="201 characters are too many"):
        clean_remark("x" * 201)


def wait(ready: Any, most: float = 10.0) -> None:
    end = time.monotonic() + most
    while not ready():
        assert time.monotonic() < end
        time.sleep(0.02)


def test_a_session_beyond_its_plan_has_no_reading_left():
    advice = types.SimpleNamespace(
        is_reached=False, is_reached_by_geometry=False, limits=np.array([np.nan]),
        more=None, planned=20, readings=22,
    )  # fmt: skip
    assert show.remaining(advice) == 0
    advice.readings = 15
    assert show.remaining(advice) == 5
