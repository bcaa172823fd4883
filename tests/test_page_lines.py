"""Readings that arrive at the page as lines: of a port, a file, a folder."""

from __future__ import annotations

import socket
import time
from pathlib import Path
from typing import Any

import pytest
from page_server import rows

from pkm_studies.base.errors import InputError
from pkm_studies.page.feed import Feed, Offer


@pytest.mark.parametrize(
    ("pattern", "line", "values"),
    [
        (r"(?P<length_um>[-+]?\d+\.\d+)", "01A+00012.34\r", {"length": 12.34e-6}),
        (r"^\S+,(?P<read_x_mm>[^,]+),(?P<read_y_mm>[^,]+)", "P1, 1.5,-2", {"read_x": 1.5e-3, "read_y": -2e-3}),
        (r"R=(?P<length_mm>[-\d,]+)", "R=300,125 ok", {"length": 0.300125}),
        (r"R=(?P<length_mm>[-\d.]+)", "no reading", None),
        (r"R=(?P<length_mm>\S+)", "R=abc", None),
    ],
)  # fmt: skip
def test_a_line_becomes_numbers(
    tmp_path: Path, pattern: str, line: str, values: dict[str, float] | None
) -> None:
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
def test_what_no_line_can_be_is_refused(source: str, pattern: str) -> None:
    with pytest.raises(InputError):
        Feed(source, pattern, lambda _: None)


def test_readings_arrive_by_tcp(machine: Any) -> None:
    """A gauge that sends a line: the entry shows it, and the page takes it at once."""
    opened, client, operator = machine
    gauge = socket.create_server(("127.0.0.1", 0))
    source = f"tcp://127.0.0.1:{gauge.getsockname()[1]}"
    opened.feed = Feed(source, r"L (?P<length_mm>[-\d.]+)", opened.arrived)
    opened.feed.start()
    line, _ = gauge.accept()
    try:
        entry = operator.display()
        line.sendall(f"L {entry[0]}\n".encode())
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


def test_a_file_that_grows_is_followed(tmp_path: Path) -> None:
    path = tmp_path / "gauge.csv"
    path.write_text("no;length_mm\n1;300.1\n", encoding="utf-8")
    offers: list[Offer] = []
    feed = Feed(str(path), "", offers.append)
    feed.start()
    time.sleep(0.2)
    with path.open("a", encoding="utf-8") as file:
        file.write("2;300,2\n3;3")
    wait(lambda: offers)
    assert offers[0].values == pytest.approx({"length": 0.3002})


def wait(ready: Any, most: float = 10.0) -> None:
    end = time.monotonic() + most
    while not ready():
        assert time.monotonic() < end
        time.sleep(0.02)
