"""`oed import` with an importer in a file of the user."""

from __future__ import annotations

from pathlib import Path

import pytest

from pkm_studies.base import InputError
from pkm_studies.commands import main
from pkm_studies.importers import import_files

OWN = '''
from pkm_studies.importers import ImportedSession

STUDY = """schema = 1
name = "%s"
title = "t"
question = "q"
machine = { model = "five_bar" }
noise = { read_x_um = 2.0, read_y_um = 2.0 }
setup = [{ name = "plate", instrument = "planar_position" }]
readings = { files = ["%s.readings.csv"] }
"""


class StageLog:
    name = "stagelog"
    about = "command and reading of a plate, mm"

    def read(self, request):
        names = ("x_mm", "y_mm", "read_x_mm", "read_y_mm")
        rows = []
        for order, line in enumerate(request.files[0].read_text().split(), 1):
            cells = dict(zip(names, line.split(";"), strict=True))
            rows.append({"setup": "plate", "run": "1", "order": str(order), **cells})
        study = STUDY % (request.name, request.name)
        return ImportedSession(study=study, rows=rows, statements=["two columns"])


importer = StageLog()
'''


pytestmark = pytest.mark.usefixtures("stranger")


def test_a_file_of_the_user_reads_once_it_is_allowed(tmp_path, capsys):
    """Two rows of two values are two readings, as the pages say."""
    own, log, out = tmp_path / "own.py", tmp_path / "stage.log", tmp_path / "out"
    own.write_text(OWN)
    log.write_text("0;300;0.1;299.9\n10;310;10.1;309.9\n")
    with pytest.raises(InputError, match="runs once you allow it"):
        import_files(str(own), [log], out)
    assert main(["import", str(own), str(log), "--out", str(out), "--allow-code"]) == 0
    study = out / "stage.study.toml"
    assert main(["check", str(study), str(out / "stage.readings.csv")]) == 0
    printed = capsys.readouterr().out
    assert "1 set-up, 2 readings" in printed
    assert "2 readings fit the columns of stage" in printed


def test_a_file_without_importer_is_refused(tmp_path):
    own = tmp_path / "own.py"
    own.write_text("reader = 1\n")
    allowed = ["import", str(own), "a.log", "--out", str(tmp_path), "--allow-code"]
    assert main(allowed) == 2
    with pytest.raises(InputError, match="no importer in it; define importer in it"):
        import_files(str(own), [Path("a.log")], tmp_path)


def test_an_unknown_kind_names_the_way_to_a_file():
    with pytest.raises(InputError, match=r"known: .*, or a file of your own"):
        import_files("stagelog", [Path("a.log")], Path("out"))
