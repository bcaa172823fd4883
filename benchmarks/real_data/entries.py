"""The real machines of the board: where their data come from, and what is fitted."""

from __future__ import annotations

import dataclasses
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
STUDIES = ROOT / "studies"
V400 = "https://github.com/fzechert/FLSun-V400"
SR = "https://github.com/danorder/Flsun-super-racer-Full-klipper-config-"
HANGPRINTER = "https://github.com/tobbelobb/auto-calibration-simulation-for-hangprinter"


@dataclasses.dataclass(frozen=True)
class Entry:
    """A machine with readings of its own.

    name     of the row
    source   repository and licence
    fetch    how a user gets the files
    folder   of them, in the data folder
    study    name of a shipped study; "" where `file` is imported
    file     configuration with readings, for `oed import klipper`
    fitted   what is fitted, in words
    blind    what is predicted, in words
    """

    name: str
    source: str
    fetch: str
    folder: str
    fitted: str
    blind: str
    study: str = ""
    file: str = ""


def _printer(
    name: str, file: str, source: str, fetch: str, fitted: str, blind: str
) -> Entry:
    return Entry(name, source, fetch, "klipper_delta", fitted, blind, file=file)


SEVEN, MESH = "7 heights", "bed meshes of the same file"
ENTRIES = (
    Entry(
        "FLSun V400, S04 to S03",
        f"{V400} at 221f53d, CC0",
        f"`git clone {V400}`; readings of all versions of `printer-config/printer*.cfg`",
        "delta_v400",
        "heights and 12 distances of a session",
        "those of another session",
        study="delta_v400",
    ),
    Entry(
        "FLSun V400, S03 to S04",
        f"{V400} at 221f53d, CC0",
        "as above",
        "delta_v400",
        "heights and 12 distances of a session",
        "those of another session",
        study="delta_v400_reverse",
    ),
    Entry(
        "Hangprinter HP4",
        f"{HANGPRINTER} at 790dca2, MIT",
        f"`git clone -b hp_mark_adjusted {HANGPRINTER}`; tables of `simulation.py`",
        "hangprinter_hp4",
        "9 poses seen by a camera",
        "whether the lines meet at 35 others",
        study="hangprinter_hp4",
    ),
    Entry(
        "Jugglebot",
        "https://github.com/Project-DeepBlue-Juggling/Jugglebot at 553f1a7, MIT",
        "`git clone`; `experimenting/platform_calibration/zOld/108_calibration_poses.csv`",
        "jugglebot",
        "54 poses by motion capture",
        "the other 54",
        study="jugglebot",
    ),
    _printer(
        "FLSun SR, danorder",
        "flsun_sr_danorder_mesh.cfg",
        f"{SR} at 5694c06, CC0",
        f"`git clone {SR}`; `printer.cfg`",
        SEVEN,
        MESH,
    ),
    _printer(
        "FLSun SR, danorder, earlier",
        "flsun_sr_danorder_mesh_2.cfg",
        f"{SR} before 5694c06, CC0",
        "as above, an earlier version",
        SEVEN,
        MESH,
    ),
    _printer(
        "FLSun SR, cupsster",
        "flsun_sr_cupsster.cfg",
        "https://github.com/cupsster/FLSUN-SR---Klipper-Config at 684183a, CC0",
        "`git clone`; `printer.cfg`",
        SEVEN,
        MESH,
    ),
    _printer(
        "FLSun V400, phnxdrgn",
        "flsun_v400_phnxdrgn.cfg",
        "https://github.com/phnxdrgn536/FLSun-v400 of 2023-01-04, CC0",
        "`git clone`; `printer.cfg`",
        "heights and 12 distances",
        MESH,
    ),
    _printer(
        "FLSun V400, fzechert",
        "flsun_v400_fzechert.cfg",
        f"{V400} at 221f53d, CC0",
        "as above; `printer.cfg`",
        "heights",
        MESH,
    ),
)
