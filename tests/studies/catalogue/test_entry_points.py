"""An installed package adds to each part of the catalogue, and a broken one does no harm."""

import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from pkm_studies import catalogue, plugins
from pkm_studies.commands import main

MODULE = '''
import dataclasses
from pkm_models.machines import planar_2dof
from pkm_models.effects import backlash
from pkm_models.instruments import camera
from pkm_studies.catalogue.controller_format import ControllerFormat
from pkm_studies.importers.base import ImportedSession

arm = dataclasses.replace(planar_2dof.machine, name="shop_arm", about="the shop's arm")
gauge = dataclasses.replace(camera.instrument, name="shop_gauge")
play = dataclasses.replace(backlash.effect, name="shop_play")
table = ControllerFormat(
    name="shop_table", about="", source="", write=lambda content: {".txt": ""}
)


STUDY = """schema = 1
name = "a"
machine = { model = "planar_2dof" }
setup = [{ name = "a", instrument = "camera", channels = ["read_y", "read_z"] }]
readings = { files = ["a.readings.csv"] }
"""


class Importer:
    name = "shop_files"
    about = "the shop's files"

    def read(self, request):
        row = {"setup": "a", "run": "1", "order": "1", "y_mm": "0", "z_mm": "500"}
        row |= {"read_y_mm": "0.01", "read_z_mm": "500.01"}
        return ImportedSession(study=STUDY, rows=[row], statements=[])


files = Importer()
'''
ENTRY_POINTS = """
[pkm_oed.machines]
shop_arm = shop_models:arm
broken = shop_models:absent
[pkm_oed.instruments]
shop_gauge = shop_models:gauge
[pkm_oed.effects]
shop_play = shop_models:play
[pkm_oed.formats]
shop_table = shop_models:table
[pkm_oed.commands]
certificate = shop_models:table
shop_command = shop_models:table
[pkm_oed.importers]
shop_files = shop_models:files
klipper = shop_models:files
shop_broken = shop_models:absent
"""
NAMES = {"instruments": "shop_gauge", "effects": "shop_play", "formats": "shop_table"}


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
    catalogue.named_items.cache_clear()
    yield
    catalogue.named_items.cache_clear()


@pytest.mark.usefixtures("installed")
def test_machine_of_a_package_is_listed():
    with pytest.warns(UserWarning, match="shop_models:absent cannot be loaded"):
        entries = {e.name: e for e in catalogue.listing("machines")}
    assert entries["shop_arm"].about == "the shop's arm"
    assert entries["shop_arm"].where == "shop_models:arm"
    assert "a3_head" in entries
    assert "broken" not in entries


@pytest.mark.usefixtures("installed")
@pytest.mark.parametrize("kind", NAMES)
def test_other_parts_of_the_catalogue(kind):
    assert NAMES[kind] in {entry.name for entry in catalogue.listing(kind)}


@pytest.mark.usefixtures("installed")
def test_importers_of_a_package(tmp_path, capsys):
    """A broken one is named, and only who asks for it is refused; no name is taken over."""
    with pytest.warns(UserWarning, match="shop_broken.*AttributeError"):
        assert main(["list", "importers", "--json"]) == 0
    listed = {
        entry["name"]: entry["about"] for entry in json.loads(capsys.readouterr().out)
    }
    assert listed["shop_files"] == "the shop's files"
    assert {"klipper", "columns"} < set(listed)
    assert "shop_broken" not in listed
    (tmp_path / "a.txt").write_text("1")
    source, out = str(tmp_path / "a.txt"), str(tmp_path / "out")
    assert main(["import", "shop_files", source, "--out", out]) == 0
    assert 'model = "planar_2dof"' in (tmp_path / "out" / "a.study.toml").read_text()
    assert "0.01,500.01" in (tmp_path / "out" / "a.readings.csv").read_text()
    assert main(["import", "klipper", source, "--out", out, "--name", "b"]) == 2
    assert "rotation_distance: missing" in capsys.readouterr().err
    assert main(["import", "shop_broken", source, "--out", out]) == 2
    assert "mend or uninstall the package" in capsys.readouterr().err


@pytest.mark.usefixtures("installed")
def test_packages_of_others_add_no_commands(capsys):
    assert main(["--help"]) == 0
    assert "shop_command" not in capsys.readouterr().out
    assert main(["certificate", "--help"]) == 0
    assert "calibration certificate" in capsys.readouterr().out


def test_what_is_not_installed_is_said(monkeypatch, capsys):
    """Its files alone, on a search path: commands of this package go on."""
    monkeypatch.setattr(plugins, "PROJECT", "pkm-absent")
    assert main(["import", "klipper", "printer.cfg", "--out", "x"]) == 2
    assert "pkm-absent is not installed" in capsys.readouterr().err
    assert main(["list", "criteria"]) == 0
