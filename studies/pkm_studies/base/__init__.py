"""What the whole package rests on: refusals of bad input, names, progress, random streams.

InputError         bad input: what, where (file, field, value), and the remedy
Location           a file and a field in it, which make such an error
SourceAbsentError  published readings that are not on this computer
Name               the name of a study or campaign, as a type of its files
NAME_PATTERN       what such a name is
check_name         refuses what is none
Progress           what long work reports to
Silent             progress that nobody watches
Stream             the stream of random numbers of each purpose
"""

from typing import TYPE_CHECKING

from oed.base import door

if TYPE_CHECKING:
    from pkm_studies.base.errors import (
        NAME_PATTERN,
        InputError,
        Location,
        Name,
        SourceAbsentError,
        check_name,
    )
    from pkm_studies.base.random_streams import Progress, Silent, Stream
else:
    __getattr__ = door(__name__)
