"""The base of every record of result.json."""

from __future__ import annotations

import msgspec


class Record(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A part of result.json: frozen, unknown fields refused."""
