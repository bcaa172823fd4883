"""Readings files of tests, loaded or refused."""

from __future__ import annotations

from pathlib import Path

import pytest

from oed import dataset
from oed.dataset import Dataset, ReadingsError
from oed.measurement.measurement import Measurement


def loaded(text: str, measurement: Measurement, folder: Path) -> Dataset:
    path = folder / "x.readings.csv"
    path.write_text(text, encoding="utf-8")
    return dataset.load(path, measurement)


def refused(text: str | bytes, measurement: Measurement, folder: Path) -> ReadingsError:
    path = folder / "x.readings.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(ReadingsError) as error:
        dataset.load(path, measurement)
    return error.value
