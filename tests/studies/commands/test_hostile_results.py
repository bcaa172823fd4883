"""A stranger's result.json: its texts are no paths, and no commands of a controller."""

import re
from pathlib import Path
from xml.etree import ElementTree

import compensation_sample
import msgspec
import pytest
from shipped_models import linear_delta

from oed.model import Machine
from pkm_page import PageOptions, open_page
from pkm_studies.base import InputError
from pkm_studies.commands import main
from pkm_studies.compensation.formats import body_names
from pkm_studies.quantities import column
from pkm_studies.study import Study

PATHS = (
    "../evil", "/elsewhere/evil", "a/b", "..", "", ".hidden", "a\nb", "evil\n",
    "C:evil", "a\\b",
)  # fmt: skip
COMMAND = "M112 (stop)"
TEXT = f"1.0 ) */ ]]> ---> --> \n{COMMAND}\r{COMMAND}\u2028{COMMAND}\x0b{COMMAND}"


def stored(folder: Path, **fields: object) -> Path:
    machine = linear_delta.machine
    content = compensation_sample.result(machine, machine.nominal)
    return compensation_sample.save(folder, msgspec.structs.replace(content, **fields))


@pytest.mark.parametrize("name", PATHS)
def test_the_name_of_a_study_is_no_path(tmp_path, name):
    folder = stored(tmp_path / "theirs", study=name)
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(InputError, match=r"result.json: study = .*no name for a study"):
        open_page(folder, PageOptions())
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize("command", [
    ["report"],
    ["compensate", "--to", "csv"],
    ["verify"],
    ["adjust"],
    ["certificate"],
])  # fmt: skip
def test_no_command_writes_outside_the_folder(tmp_path, capsys, command):
    folder = stored(tmp_path / "theirs", study="../evil")
    assert main([command[0], str(folder), *command[1:]]) == 2
    assert "study" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["theirs"]


def test_the_name_of_a_study_ends_with_its_line(tmp_path):
    """Python lets a line feed follow the end of a pattern."""
    text = compensation_sample.study_text("linear_delta")
    with pytest.raises(InputError, match="letters, digits"):
        Study.parse(text.replace('"sample"', '"sample\\n"'), tmp_path / "s.study.toml")


def test_no_text_of_a_result_is_a_command_of_a_controller(tmp_path):
    """Each line of the text stays inside the comment that it is written into."""
    few = ["--commands", "64"]
    formats = {"csv": few, "json": few, "c": [], "klipper": [], "rrf": [], "marlin": []}
    for word, options in (formats | {"linuxcnc": [], "gcode": []}).items():
        folder = hostile(tmp_path / word, linear_delta.machine)
        assert main(["compensate", str(folder), "--to", word, *options]) in (0, 1, 2)
        texts = [p.read_text("utf-8") for p in folder.glob("compensation*")]
        assert texts, word
        for line in "\n".join(texts).splitlines():
            assert not line.startswith("M112"), word
            assert not re.match(r"^[^(;#]*\)\s*M112", line), word


@pytest.mark.parametrize("dashes", range(8))
def test_no_text_of_a_result_ends_a_comment_in_xml(dashes):
    text = "-" * dashes + ">" + "-" * dashes
    whole = body_names.commented(ElementTree.Element("robot"), [text, text])
    assert ElementTree.fromstring(whole).tag == "robot"


def hostile(folder: Path, machine: Machine) -> Path:
    """A result with commands wherever it has text."""
    home = {column(c.name, c.unit): 0.0 for c in machine.command}
    design = compensation_sample.design([home])
    poses = [msgspec.structs.replace(p, setup=TEXT, run=TEXT) for p in design.poses]
    content = compensation_sample.result(
        machine, machine.nominal, design=msgspec.structs.replace(design, poses=poses)
    )
    hostile = msgspec.structs.replace(content, version=TEXT, title=TEXT, question=TEXT)
    return compensation_sample.save(folder, hostile)
