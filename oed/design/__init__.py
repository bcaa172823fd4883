"""Plans of readings: criteria, bounds, search, stages.

CRITERIA          the catalogue of criteria, by name
Choice            chosen candidates and their certificate
NamedCriterion    a criterion as the catalogue lists it
choose            candidates chosen by a criterion
choose_from_file  the same from a file that does not fit in memory
open_candidates   candidates in a file
"""

from typing import TYPE_CHECKING

from oed.base import door

if TYPE_CHECKING:
    from oed.design.candidate_file import open_candidates
    from oed.design.catalogue import CRITERIA, NamedCriterion
    from oed.design.exchange import Choice, choose
    from oed.design.large import choose_from_file
else:
    # imported when first used: a report needs the criteria alone
    __getattr__ = door(__name__)
