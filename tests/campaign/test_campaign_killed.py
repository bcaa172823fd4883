"""A campaign that is killed again and again ends as an unbroken one."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

SEEDS, KILLS = 500, 5
FUNCTION = """\
import numpy as np

def figures(setting, seed):
    rng = np.random.default_rng([len(setting["law"]), setting["size"], seed])
    values = rng.standard_normal(setting["size"])
    return {"mean": values.mean(), "largest": values.max()}
"""
CAMPAIGN = f"""\
schema = 1
name = "killed"
case = "own.py:figures"
seeds = {SEEDS}

[vary]
law = ["white", "student"]
size = [10, 1000]
"""
COMMAND = "import sys; from pkm_studies import cli; sys.exit(cli.main(sys.argv[1:]))"


@pytest.fixture
def campaign(tmp_path: Path) -> Path:
    (tmp_path / "own.py").write_text(FUNCTION, encoding="utf-8")
    path = tmp_path / "killed.campaign.toml"
    path.write_text(CAMPAIGN, encoding="utf-8")
    return path


def start(campaign: Path, out: Path) -> subprocess.Popen[bytes]:
    arguments = ["campaign", str(campaign), "--out", str(out), "--workers", "2"]
    return subprocess.Popen(
        [sys.executable, "-c", COMMAND, *arguments, "--quiet"],
        stdout=subprocess.DEVNULL,
        env={**os.environ, "CAMPAIGN_UNDER_TEST": str(out)},
    )


def stored(out: Path) -> int:
    return len(list((out / "cases").glob("*-*.json")))


def processes(out: Path) -> list[int]:
    """Processes of the campaign that still run, with those that it started."""
    mark = f"CAMPAIGN_UNDER_TEST={out}".encode()
    running = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            environment = (folder / "environ").read_bytes()
            state = (folder / "stat").read_text(encoding="utf-8").split()[2]
        except OSError:
            continue
        if mark in environment.split(b"\0") and state != "Z":
            running.append(int(folder.name))
    return running


def kill_at(campaign: Path, out: Path, count: int, delay: float) -> None:
    """Kill the command, and it alone, once so many cases are stored and a while later."""
    process = start(campaign, out)
    while stored(out) < count:
        assert process.poll() is None, "it ended before it was killed"
        time.sleep(0.002)
    time.sleep(delay)
    process.send_signal(signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL
    patience = time.monotonic() + 20.0
    while processes(out):
        assert time.monotonic() < patience, "its processes outlive it"
        time.sleep(0.05)


@pytest.mark.slow
@pytest.mark.skipif(
    not Path("/proc/self/environ").exists(), reason="needs the processes of Linux"
)
def test_a_campaign_killed_five_times_ends_as_an_unbroken_one(
    campaign: Path, tmp_path: Path
) -> None:
    broken, whole = tmp_path / "broken", tmp_path / "whole"
    rng = np.random.default_rng()  # another moment in every run of this test
    total = 4 * SEEDS
    for count in np.sort(rng.integers(1, int(0.8 * total), KILLS)):
        kill_at(campaign, broken, max(int(count), stored(broken)), rng.uniform(0, 0.05))
        assert stored(broken) < total
    for out in (broken, whole):
        assert start(campaign, out).wait() == 0
    table = pd.read_parquet(broken / "cases.parquet")
    assert len(table) == total == stored(broken)
    assert len(table.drop_duplicates(["law", "size", "seed"])) == total
    for name in ("cases.parquet", "cases.csv", "summary.csv", "report.html"):
        assert (broken / name).read_bytes() == (whole / name).read_bytes()
