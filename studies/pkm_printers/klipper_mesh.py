"""Klipper: the saved profiles of [bed_mesh], as heights of the nozzle at contact.

A profile's places are those of the probe, its heights those of the nozzle less the
probe's z_offset (`probe_finalize` in klippy/extras/bed_mesh.py). On a round bed a row
is filled up with its first and last probed height. Nodes in a faulty region were probed
beside it.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Final

import numpy as np

from oed.base import Array, Mask
from pkm_printers import klipper_config
from pkm_printers.bed_mesh import BedMesh, copied_margin
from pkm_printers.delta_study import Offset
from pkm_printers.klipper_config import KlipperConfig
from pkm_printers.probed_point import ProbedPoint

PREFIX: Final = "bed_mesh "
PROBES: Final = ("probe", "bltouch", "smart_effector")
#: options of any other section that is a probe: [scanner], [probe_eddy_current x]
OFFSETS: Final = ("x_offset", "y_offset")
REMEDY: Final = "import the profile as SAVE_CONFIG wrote it, or remove it"
#: mm; no mesh has a larger height
LARGEST: Final = 100.0
MARGIN: Final = "the firmware filled them up from probed ones"


def meshes(config: KlipperConfig) -> list[BedMesh]:
    """The saved profiles, in the file's order. Raises InputError."""
    sections = dict.fromkeys(
        name for name, _ in config.entries if name.startswith(PREFIX)
    )
    return [_mesh(config, section) for section in sections]


def _mesh(config: KlipperConfig, section: str) -> BedMesh:
    z = _heights(config, section)
    x = _places(config, section, "x", z.shape[1])
    y = _places(config, section, "y", z.shape[0])
    margin = copied_margin(x, y, z)
    if config.find("bed_mesh", "mesh_radius") is not None and not margin.any():
        entry = config.entries[section, "points"]
        raise entry.error(
            f"[{section}] points",
            "nodes beyond [bed_mesh] mesh_radius have heights of their own, where Klipper"
            " probes none: a fork's nodes are elsewhere",
            "remove the profile from a copy of the file",
        )
    unread = margin | _is_in_faulty_region(config, x, y)
    offset = probe_offset(config)
    rows, columns = np.nonzero(~unread)
    points = [
        ProbedPoint(
            float(x[j] - offset[0]), float(y[i] - offset[1]), float(z[i, j]), offset
        )
        for i, j in zip(rows, columns, strict=True)
    ]
    name = section.removeprefix(PREFIX).strip()
    return BedMesh(name, tuple(points), int(unread.sum()), MARGIN)


def _heights(config: KlipperConfig, section: str) -> Array:
    """Heights (ny, nx), mm. Raises InputError."""
    entry = config.find(section, "points")
    if entry is None:
        raise config.missing(section, "points", REMEDY)
    count = round(config.positive(section, "x_count"))
    rows = [line for line in entry.text.splitlines() if line.strip()]
    if len(rows) != round(config.positive(section, "y_count")):
        problem = f"{len(rows)} rows, where y_count has another number"
        raise entry.error(f"[{section}] points", problem, REMEDY)
    option = f"[{section}] points"
    written = [klipper_config.Entry(row, entry.file, entry.line) for row in rows]
    heights = np.array([klipper_config.numbers(row, option, count) for row in written])
    if np.abs(heights).max() > LARGEST:
        problem = f"no bed is {np.abs(heights).max():.3g} mm uneven"
        raise entry.error(option, problem, REMEDY)
    return heights


def _places(config: KlipperConfig, section: str, axis: str, count: int) -> Array:
    low = config.number(section, f"min_{axis}")
    high = config.number(section, f"max_{axis}")
    if low >= high or count < 2:
        entry = config.entries[section, f"max_{axis}"]
        problem = "the mesh has no width"
        raise entry.error(f"[{section}] max_{axis}", problem, REMEDY)
    return np.linspace(low, high, count)


def probe_offset(config: KlipperConfig) -> Offset:
    """Place (2,) of the probe from the nozzle, mm; 0 without a probe of its own place."""
    return of_probe(config, "x_offset", 0.0), of_probe(config, "y_offset", 0.0)


def of_probe(config: KlipperConfig, key: str, default: float) -> float:
    """A number of the section of the probe."""
    for section in (*PROBES, *other_probes(config)):
        if config.find(section, key) is not None:
            return config.number(section, key)
    return default


def other_probes(config: KlipperConfig) -> list[str]:
    """Sections of other names that say where a probe is."""
    stated = (section for section, key in config.entries if key in OFFSETS)
    return [section for section in dict.fromkeys(stated) if section not in PROBES]


def _is_in_faulty_region(config: KlipperConfig, x: Array, y: Array) -> Mask:
    """Which nodes (ny, nx) lie in a faulty region of [bed_mesh]."""
    inside = np.zeros((len(y), len(x)), dtype=bool)
    for low, high in _faulty_regions(config):
        across = (x >= low[0]) & (x <= high[0])
        along = (y >= low[1]) & (y <= high[1])
        inside |= along[:, None] & across[None, :]
    return inside


def _faulty_regions(config: KlipperConfig) -> Iterator[tuple[list[float], list[float]]]:
    """Two corners (2,), mm, of each region."""
    for section, key in config.entries:
        match = re.fullmatch(r"faulty_region_(\d+)_min", key)
        if section != "bed_mesh" or match is None:
            continue
        corners = []
        for end in ("min", "max"):
            option = f"faulty_region_{match[1]}_{end}"
            entry = config.find(section, option)
            if entry is None:
                raise config.missing(section, option, "give both corners of the region")
            corners.append(klipper_config.numbers(entry, f"[{section}] {option}", 2))
        yield corners[0], corners[1]
