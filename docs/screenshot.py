"""Make the picture of the page at the machine: a head with 12 virtual readings.

.venv/bin/python docs/screenshot.py docs/img
"""

from __future__ import annotations

import shutil
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
import uvicorn
from playwright.sync_api import sync_playwright

from oed.measurement import draw_parameters
from pkm_page import MachinePage, PageOptions, Switch, open_page

PORT, READINGS = 8766, 12


def measure(page: MachinePage) -> None:
    """Take readings of a virtual machine."""
    rng = np.random.default_rng(5)
    session = page.session
    machine = session.measurement
    truth = draw_parameters(machine, rng)
    for number in range(READINGS):
        pose = session.state.pose
        if pose is None:
            raise SystemExit(session.state.problem)
        one = [pose.series.take(np.array([pose.row]))]
        y = machine.readings(one, truth) + machine.sigma(one) * rng.standard_normal(1)
        version = session.state.content.version
        session.take(version, str(number), [f"{1e3 * y[0]:.4f}"], "", confirmed=True)


def main(out: Path) -> None:
    """Write serve.png into a folder."""
    with tempfile.TemporaryDirectory() as folder:
        options = PageOptions(Path(folder) / "poses.csv")
        page, shelf = open_page(Path("a3_ball_bar"), options)
        if page is None:
            raise SystemExit("no study")
        measure(page)
        config = uvicorn.Config(Switch(page, shelf), port=PORT, log_level="error")
        threading.Thread(target=uvicorn.Server(config).run, daemon=True).start()
        time.sleep(1.0)
        with sync_playwright() as driver:
            chromium = shutil.which("chromium")
            browser = driver.chromium.launch(
                executable_path=chromium, args=["--no-sandbox"]
            )
            size = {"width": 1440, "height": 900}
            tab = browser.new_page(viewport=size, device_scale_factor=0.75)
            tab.goto(f"http://127.0.0.1:{PORT}/")
            tab.wait_for_timeout(500)
            tab.screenshot(path=out / "serve.png")
            browser.close()


if __name__ == "__main__":
    main(Path(sys.argv[1]))
