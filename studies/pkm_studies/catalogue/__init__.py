"""Machines, instruments, effects, criteria and formats by name.

KINDS             the kinds of things that have names
listing           all entries of a kind
CatalogueEntry    one of them: name, source, what it is
named_items       the items themselves, by name
machine           the machine that a study names
instrument        the instrument that it names
effect            the effect that it names
function          a function of the user, as a campaign names it
lookup            an item of any kind
ControllerFormat  a format of `oed compensate`, as its file states it
Compensation      what a format writes: machine, parameters, tables, poses
Identified        the parameters that it holds, with what they rest on
MeasuringPose     a pose of the measurement, and its set-up
Texts             files by name
MAX_COMMENT_LENGTH   characters of a line of comment
"""

from typing import TYPE_CHECKING

from oed.base import door

if TYPE_CHECKING:
    from pkm_studies.catalogue.catalogue import (
        KINDS,
        CatalogueEntry,
        effect,
        function,
        instrument,
        listing,
        lookup,
        machine,
        named_items,
    )
    from pkm_studies.catalogue.controller_format import (
        MAX_COMMENT_LENGTH,
        Compensation,
        ControllerFormat,
        Identified,
        MeasuringPose,
        Texts,
    )
else:
    __getattr__ = door(__name__)
