"""CSV files of other programs: separators, encodings, names over several lines."""

import numpy as np
import pytest

from pkm_studies import csv_table
from pkm_studies.base import InputError


@pytest.mark.parametrize(("text", "header"), [
    ("a,b\n1,2\n3,4\n", ("a", "b")),
    ("a\tb\n1\t2\n3\t4\n", ("a", "b")),
    ("1 2.5\n3 4\n", ("1", "2")),
    ("Test 5\n\na; b\n1,5;2\n3;4\n", ("a", "b")),
    ("Machine,M\nFeed,1500\n\na,b\n1,2\n3,4\n", ("a", "b")),
    ("a,b\n1,2\na,b\n3,4\n", ("a", "b")),
])  # fmt: skip
def test_tables_of_any_separator(text, header, tmp_path):
    (tmp_path / "t.csv").write_text(text)
    table = csv_table.read(tmp_path / "t.csv")
    assert table.header == header
    assert len(table) == 2
    assert table.numbers(header[1])[1] == 4.0


@pytest.mark.parametrize("encoding", ["cp1252", "utf-16", "utf-8-sig"])
def test_a_file_of_another_program_has_an_encoding_of_its_own(encoding, tmp_path):
    path = tmp_path / "t.csv"
    path.write_bytes("X [mm],Température [°C]\n1.5,20\n2.5,21\n".encode(encoding))
    table = csv_table.read(path)
    assert table.header == ("X [mm]", "Température [°C]")
    np.testing.assert_array_equal(table.numbers("X [mm]"), [1.5, 2.5])
    path.write_bytes(b"PK\x03\x04\x00\xff,1\n2,3\n")  # a workbook with this name
    with pytest.raises(InputError, match="no UTF-8 text"):
        csv_table.read(path)


MARKERS = ("rig:a X [mm]", "rig:a Y [mm]", "rig:a Z [mm]", "rig:b X [mm]")


@pytest.mark.parametrize(("lines", "header"), [
    (("Trajectories,,,,,,,", "100,,,,,,,", ",,rig:a,,,rig:b,,", "Frame,Sub Frame,X,Y,Z,X,Y,Z",
      ",,mm,mm,mm,mm,mm,mm"),
     ("Frame", "Sub Frame", *MARKERS)),
    (("PathFileType,4,(X/Y/Z),a.trc,,,,", "DataRate,CameraRate,NumFrames,NumMarkers,Units,,,",
      "100,100,2,2,mm,,,", "Frame#,Time,a,,,b,,", ",,X1,Y1,Z1,X2,Y2,Z2", ",,,,,,,"),
     ("1", "2", "X1", "Y1", "Z1", "X2")),
])  # fmt: skip
def test_markers_side_by_side_have_their_names(lines, header, tmp_path):
    """Facts of the file, such as a rate, are no readings; a name is over three columns."""
    path = tmp_path / "m.csv"
    path.write_text("\n".join([*lines, "1,0,1,2,3,4,5,6", "2,0,7,8,9,10,11,12"]))
    table = csv_table.read(path)
    assert table.header[:6] == header
    assert len(table) == 2
    np.testing.assert_array_equal(table.numbers(header[2]), [1.0, 7.0])


def test_a_first_row_with_empty_cells_is_no_header(tmp_path):
    """As a reference row has them, which reads nothing."""
    path = tmp_path / "s.readings.csv"
    path.write_text(
        "setup,run,order,y_mm,z_mm,dy_mm,dz_mm\nm,one,1,0,0,,\nm,one,2,0,3,.1,.2\n"
    )
    read = csv_table.read(path)
    assert read.header == ("setup", "run", "order", "y_mm", "z_mm", "dy_mm", "dz_mm")
    assert len(read) == 2
