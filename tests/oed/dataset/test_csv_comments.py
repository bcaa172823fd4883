"""Lines with # above the header of a readings file."""

import pytest
import sample

from oed import dataset
from oed.measurement import Measurement


@pytest.fixture(scope="module")
def head() -> Measurement:
    return sample.resolved().measurement


@pytest.mark.parametrize(
    "above",
    [
        "# made at the machine\n# psi_deg: from x to y, in degrees\n",
        '"# psi_deg: from x to y, in degrees"\n\n"# again; with ""quotes"""\n',
        "\n# a blank line above, and one below\n\n",
        "sep=,\n# Excel's line first\n",
    ],
)
def test_comments_above_the_header_are_no_rows(tmp_path, head, above):
    """Read as without them; errors count the lines as the file has them."""
    plain, commented = tmp_path / "a.csv", tmp_path / "b.csv"
    plain.write_text(sample.READINGS)
    commented.write_text(above + sample.READINGS)
    first, second = (dataset.load(path, head) for path in (plain, commented))
    assert second.y == pytest.approx(first.y)
    commented.write_text(above + sample.READINGS.replace("300.002", "many"))
    with pytest.raises(dataset.ReadingsError) as caught:
        dataset.load(commented, head)
    lines = above.removeprefix("sep=,\n").count("\n")
    assert f"row {lines + 3}, column length_mm" in str(caught.value)


def test_comments_alone_are_no_readings(tmp_path, head):
    path = tmp_path / "c.csv"
    path.write_text("# nothing else\n")
    with pytest.raises(dataset.ReadingsError, match="no header below the comments"):
        dataset.load(path, head)
