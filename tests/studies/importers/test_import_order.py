"""Tables whose lines carry times: in the order of time, or refused."""

import pytest

from pkm_studies.base import InputError
from pkm_studies.importers import read_tables


@pytest.mark.parametrize("times", ["clock", "number"])
def test_a_table_with_the_newest_line_first_is_refused(times, tmp_path):
    cells = [f"10:0{k}:00" if times == "clock" else f"17000000{k}.25" for k in range(6)]
    lines = [f"{cell},{k}.5,{k * k}.5" for k, cell in enumerate(cells)]
    file = tmp_path / "t.csv"
    file.write_text("\n".join(["stamp,x,y", *lines]))
    assert len(read_tables([file])[0]) == 6
    file.write_text("\n".join(["stamp,x,y", *lines[::-1]]))
    with pytest.raises(InputError, match="the newest stands first"):
        read_tables([file])
    # a time that begins anew with each run is in order
    file.write_text("\n".join(["time,x,y", *lines, *lines]))
    assert len(read_tables([file])[0]) == 12
