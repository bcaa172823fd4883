"""What the parameters of a certificate rest on, in its sentences."""

import msgspec
import report_fixture
from result_sample import whole

from pkm_certificate import build


def test_without_a_correction_the_accuracy_is_over_all_answers():
    """As the acceptance test promises it: the compensation sent holds no effects."""
    result = report_fixture.result_of(whole())
    sent_alone = msgspec.structs.replace(result, corrected=None)
    assert build.OVER_ANSWERS in build.conditions(sent_alone)
    assert build.OVER_ANSWERS not in build.conditions(result)
