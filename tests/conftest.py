"""What the tests share."""

from pathlib import Path

import numpy as np
import pytest


@pytest.fixture
def rng() -> np.random.Generator:
    """The same random numbers for every test."""
    return np.random.default_rng(20160801)


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Real measurements, kept beside the project and not in it."""
    folder = Path(__file__).resolve().parents[2] / "shared" / "data"
    if not folder.is_dir():
        pytest.skip("the folder shared/data with real measurements is not beside the project")
    return folder
