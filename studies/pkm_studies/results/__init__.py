"""Stored results: read, held against the study's claims, and their advice on a budget.

load_result          the result of a folder
read_result          the result of a file
BadFitError          a fit that promises nothing: an exit of its own
refuse_bad_fit       raises it where nothing may rest on a result's fit
check_claims         the claims of a study, held against its result
check_claim          one of them
claim_failure        why a claim fails, in a sentence
value_at             the value of a result at a claim's path
Values               an accuracy by component, in its unit
advice_on            what brings most: the lines of a budget in sentences
error_quantities     an accuracy in words
error_ratio          the size of an accuracy beside another's
unmodelled_sentence  what errors beside the model's parameters add
"""

from typing import TYPE_CHECKING

from oed.base import door

if TYPE_CHECKING:
    from pkm_studies.results.budget_advice import (
        Values,
        advice_on,
        error_quantities,
        error_ratio,
        unmodelled_sentence,
    )
    from pkm_studies.results.claims import (
        check_claim,
        check_claims,
        claim_failure,
        value_at,
    )
    from pkm_studies.results.stored_result import (
        BadFitError,
        load_result,
        read_result,
        refuse_bad_fit,
    )
else:
    __getattr__ = door(__name__)
