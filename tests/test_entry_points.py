"""An installed package adds machines, instruments and effects to the catalogue."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from pkm_studies import catalogue

MODULE = """
import dataclasses
from pkm_models.machines import planar_2dof
arm = dataclasses.replace(planar_2dof.machine, name="shop_arm", about="the shop's arm")
"""
ENTRY_POINTS = """
[pkm_oed.machines]
shop_arm = shop_models:arm
broken = shop_models:absent
"""


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A package as an installer leaves it: a module and its metadata on the path."""
    (tmp_path / "shop_models.py").write_text(MODULE)
    metadata = tmp_path / "shop_models-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: shop-models\nVersion: 1.0\n"
    )
    (metadata / "entry_points.txt").write_text(ENTRY_POINTS)
    monkeypatch.syspath_prepend(str(tmp_path))
    catalogue._items.cache_clear()
    yield
    catalogue._items.cache_clear()


@pytest.mark.usefixtures("installed")
def test_machine_of_a_package_is_listed() -> None:
    with pytest.warns(UserWarning, match="shop_models:absent cannot be loaded"):
        entries = {e.name: e for e in catalogue.listing("machines")}
    assert entries["shop_arm"].about == "the shop's arm"
    assert entries["shop_arm"].where == "shop_models:arm"
    assert "a3_head" in entries
    assert "broken" not in entries
