"""An effect that varies faster than its table is none that a controller corrects."""

from types import SimpleNamespace

import pytest

from pkm_studies.stages.correct import mixture


@pytest.mark.parametrize(
    ("cost", "is_coarse"), [(0.1, False), (0.7, False), (22.0, True)]
)
def test_tables_that_cost_more_than_what_stays_are_too_coarse(cost, is_coarse):
    """A period of 10 mm in a table of 120 mm steps: 22 um where .74 um stay."""
    table = SimpleNamespace(effect="screw_cyclic", interpolation={"z": cost})
    after = SimpleNamespace(after=SimpleNamespace(rms=0.74))
    section = SimpleNamespace(tables=[table])
    predicted = SimpleNamespace(components={"z": after})
    assert mixture._is_too_coarse(section, predicted) == is_coarse
    assert not mixture._is_too_coarse(section, None)
