"""The page in a browser: sessions of a headless operator, its look, and sudden ends.

The tests need a Chromium of the system, and are skipped where there is none.
"""

import contextlib
import http.client
import itertools
import os
import random
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from page.page_server import Client, Operator, rows, served
from pkm_page import server
from pkm_studies import shipped
from pkm_studies.sessions import Adviser
from pkm_studies.study import Study

SIZES = {390: 844, 820: 1180, 1440: 900}
MAX_SECONDS = 0.8  #: processor time from an entry to the new state, s
KILLS = 50  #: sudden ends of the server


@pytest.fixture
def opened(browser: Any) -> Iterator[Callable[..., Any]]:
    """Opens the page; at the end no error has reached the console."""
    contexts, said = [], []

    def open_page(port: int, width: int = 1440, scheme: str = "light") -> Any:
        size = {"width": width, "height": SIZES[width]}
        context = browser.new_context(viewport=size, color_scheme=scheme)
        contexts.append(context)
        page = context.new_page()
        page.on("pageerror", lambda error: said.append(str(error)))
        page.goto(f"http://127.0.0.1:{port}/")
        return page

    yield open_page
    for context in contexts:
        context.close()
    assert said == []


def enter(page: Any, entries: list[str], number: int) -> float:
    """Type a reading, wait for the next one's number; processor seconds of the server."""
    for place, entry in zip(
        page.locator("#entry [name=value]").all(), entries, strict=True
    ):
        place.fill(entry)
    began = time.process_time()
    page.keyboard.press("Enter")
    page.locator("#pose h2", has_text=re.compile(rf"eading {number + 1}\b")).wait_for()
    return time.process_time() - began


def axe_faults(page: Any) -> list[str]:
    from axe_playwright_python.sync_playwright import Axe

    violations = Axe().run(page).response["violations"]
    return [f"{v['id']}: {v['nodes'][0]['target']}" for v in violations]


def decides_alike(machine: Any, adviser: Adviser) -> bool:
    """Whether `oed next` on the file says what the page's session says."""
    advice = adviser.advise(machine.session.log.path)
    shown = machine.session.state.advice
    return bool(
        advice.candidate == shown.candidate
        and np.allclose(advice.known, shown.known, rtol=1e-12)
    )


@pytest.mark.slow
def test_a_session_with_everything_that_goes_wrong(opened, tmp_path):
    """Hexapod, 40 readings: a typing error, a wrong reading, an undo, a reload."""
    study = Path("hexapod_ball_bar")
    adviser = Adviser(Study.load(shipped.study_path(study)))
    path = tmp_path / "poses.csv"
    with served(study, server.PageOptions(path)) as (machine, port):
        operator, page = Operator(machine), opened(port, 820)
        seconds, number = [], 1
        while number <= 40:
            entry = operator.display()
            if number == 10:  # the decimal point is forgotten
                page.fill("#first-value", entry[0].replace(".", ""))
                page.keyboard.press("Enter")
                page.locator("#ask").wait_for()
                assert "decimal point misplaced" in page.text_content("#ask-words")
                page.click("#ask-no")
            if number == 20:  # a wrong reading is taken in spite of the question
                page.fill("#first-value", f"{float(entry[0]) + 5.0:.4f}")
                page.keyboard.press("Enter")
                page.click("#ask-yes")
                page.get_by_role("button", name="Undo reading 20").wait_for()
                page.get_by_role("button", name="Undo reading 20").click()
                page.locator("#pose h2", has_text=re.compile(r"eading 20\b")).wait_for()
                entry = operator.display()
            if number == 30:
                page.reload()
            seconds.append(enter(page, entry, number))
            assert decides_alike(machine, adviser)
            number += 1
        table = rows(path)
        assert len([row for row in table if row["length_mm"]]) == 40
        (undone,) = [row for row in table if not row["length_mm"]]
        assert undone["remark"].startswith("undone: length_mm = ")
    print(f"seconds: 95 % {np.quantile(seconds, 0.95):.3f}, most {max(seconds):.3f}")
    assert np.quantile(seconds, 0.95) < MAX_SECONDS


@pytest.mark.slow
def test_everyone_can_read_the_page(opened, page_study, tmp_path):
    """No fault of accessibility, nothing wider than the window, at any size and theme."""
    options = server.PageOptions(tmp_path / "poses.csv", wanted="z_um=50")
    with served(page_study, options) as (machine, port):
        operator = Operator(machine)
        page = opened(port)
        for number in range(1, 6):
            enter(page, operator.display(), number)
        page.fill("#first-value", "12")
        page.keyboard.press("Enter")
        page.locator("#ask").wait_for()
        for width in SIZES:
            for scheme in ("light", "dark"):
                page = opened(port, width, scheme)
                page.click("summary:has-text('combinations')")
                page.get_by_role("button", name="Number pad").click()
                assert page.evaluate("document.documentElement.scrollWidth") <= width
                assert axe_faults(page) == []


@pytest.mark.slow
def test_two_browsers_show_one_state(opened, page_study, tmp_path):
    with served(page_study, server.PageOptions(tmp_path / "poses.csv")) as (
        machine,
        port,
    ):
        operator, first, second = Operator(machine), opened(port), opened(port, 390)
        for number in range(1, 7):
            enter(first if number % 2 else second, operator.display(), number)
            other = second if number % 2 else first
            words = re.compile(rf"Reading {number + 1}\b")
            other.locator("#pose h2", has_text=words).wait_for(timeout=3000)
        assert len(rows(tmp_path / "poses.csv")) == 6


@pytest.mark.slow
def test_from_readings_to_the_controller(opened, page_study, tmp_path):
    """With the page alone: fit, result, compensation file."""
    with served(page_study, server.PageOptions(tmp_path / "poses.csv")) as (
        machine,
        port,
    ):
        operator, page = Operator(machine), opened(port)
        for number in range(1, 23):
            enter(page, operator.display(), number)
        page.get_by_role("button", name="Fit alone").click()
        page.locator("article.card").wait_for(timeout=120_000)
        page.get_by_text("identify: done").wait_for(timeout=120_000)
        with page.expect_download() as download:
            page.get_by_role("button", name="Compensation file").click()
        (written,) = tmp_path.glob("measured-*/compensation.csv")
        assert Path(download.value.path()).read_bytes() == written.read_bytes()
        with page.context.expect_page() as report:
            page.get_by_role("link", name="Report").first.click()
        assert "length" in report.value.text_content("main")


@pytest.mark.slow
def test_from_sizes_to_the_first_reading(opened, tmp_path):
    """With the page alone: a family's sizes, an error at its field, the machine's page."""
    with served(tmp_path, server.PageOptions()) as (_, port):
        page = opened(port)
        page.get_by_role("link", name="New study").first.click()
        page.locator("#scene").wait_for()
        assert axe_faults(page) == []
        reach = page.locator("[name='geometry.reach_mm'] table input")
        reach.fill("-5")
        page.locator("[name='geometry.reach_mm'] .fault").wait_for()
        reach.fill("80.0")
        page.locator(".fault").wait_for(state="detached")
        circle = page.locator("[name='geometry.base_mm']")
        circle.get_by_text("They lie on a circle").click()
        for name, value in (("diameter", "700"), ("between", "20"), ("first", "0")):
            circle.locator(f"[data-circle={name}]").fill(value)
        circle.get_by_role("button", name="Fill in").click()
        page.fill("[name=time]", "two days")
        page.fill("[name='wanted.z_um']", "30")
        page.get_by_role("button", name="Write the study").click()
        page.locator("#entry").wait_for(timeout=60_000)
        written = Study.load(tmp_path / "hexapod_ups.study.toml")
        assert written.machine.geometry["reach_mm"] == 80.0
        angles = np.radians([-10, 10, 110, 130, 230, 250])
        expected = 350.0 * np.column_stack([np.cos(angles), np.sin(angles), 0 * angles])
        np.testing.assert_allclose(
            written.machine.geometry["base_mm"], expected, atol=1e-5
        )


# -- sudden ends -----------------------------------------------------------------------
def started(study: Path, path: Path) -> tuple[subprocess.Popen[str], Client]:
    """`oed serve` in a process of its own, and a client of it."""
    command = [sys.executable, "-m", "pkm_studies.commands.cli", "serve", str(study)]
    process = subprocess.Popen(
        [*command, "--readings", str(path), "--port", "0"],
        stdout=subprocess.PIPE,
        text=True,
    )
    line = process.stdout.readline()
    port = re.search(r":(\d+)/", line)
    assert port is not None, line
    return process, Client(int(port[1]))


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="Windows has no such signal")
def test_nothing_is_lost_at_50_sudden_ends(page_study, tmp_path):
    """Killed at random moments: what was confirmed is in the file, once, and it is whole."""
    rng, path = random.Random(7), tmp_path / "poses.csv"
    confirmed: dict[str, str] = {}
    pace = 0.2  # of one reading on this computer, s
    for k in range(KILLS):
        process, client = started(page_study, path)
        began = time.monotonic()
        if k == 0:
            confirmed |= read_once(client, f"entry {k}")
            pace = time.monotonic() - began
        delay = rng.uniform(0.1, 4.0) * pace
        killer = threading.Timer(delay, process.kill)
        killer.start()
        with contextlib.suppress(OSError, ValueError, http.client.HTTPException):
            for number in itertools.count(1):  # until the server has ended
                confirmed |= read_once(client, f"entry {k}.{number}")
        killer.join()
        process.communicate()
        assert process.returncode == -signal.SIGKILL
        if path.exists():
            check_file(path, confirmed)
        assert len([p for p in tmp_path.iterdir() if p.name.endswith(".part")]) <= 1
    print(f"{len(confirmed)} readings confirmed, {len(rows(path))} in the file")
    assert len(confirmed) > KILLS // 3


def read_once(client: Client, remark: str) -> dict[str, str]:
    """Send the expected value; remark and value once the page has confirmed them."""
    state = client.state()
    expected = re.search(r"should read ([\d.]+)", state["parts"]["pose"])
    values = {"version": state["version"], "key": remark, "remark": remark}
    status, _ = client.post("/reading", entries=[expected[1]], confirmed=True, **values)
    assert status == 200
    return {remark: expected[1]}


def check_file(path: Path, confirmed: dict[str, str]) -> None:
    """Every confirmed reading is in the file once, in order, and no row is cut off."""
    table = rows(path)
    written = {row["remark"]: row["length_mm"] for row in table}
    assert len(written) == len(table)
    for remark, value in confirmed.items():
        assert float(written[remark]) == float(value)
    assert [int(row["order"]) for row in table] == list(range(1, len(table) + 1))
    assert path.read_bytes().endswith(b"\n")
