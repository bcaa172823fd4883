"""Published collections of readings, converted as they are read."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

from pkm_studies.study.data_sources import delta_v400, hangprinter_hp4, jugglebot
from pkm_studies.study.data_sources.tables import Row

#: each collection gives rows of a readings file, as text by column, from its folder
SOURCES: dict[str, Callable[[Path], Iterator[Row]]] = {
    "delta_v400": delta_v400.rows,
    "hangprinter_hp4": hangprinter_hp4.rows,
    "jugglebot": jugglebot.rows,
}
