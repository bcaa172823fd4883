"""A machine after its first result: the next reading, its history, what to adjust by hand.

Adviser               advises the next reading of a study, and says when to stop
Advice                what it says: accuracy known so far, the next reading, its effect
FittedReadings        the readings of a file with their fit, as the adviser takes them
SkippedPose           a pose of a readings file that its remark skips
visit_lines           the second visit that a diagnosis advises, in lines
compare               what changed between two results of one machine
write_comparison      a report of several results side by side
machine_history       how a machine drifts over its results, and when to calibrate again
adjust_folder         what a fitter adjusts at the machine of a result, and by how much
adjustment_sentences  its lines, with the accuracy after each
"""

from typing import TYPE_CHECKING

from oed.base import door

if TYPE_CHECKING:
    from pkm_studies.sessions.adjustment import adjust_folder, adjustment_sentences
    from pkm_studies.sessions.history import compare, machine_history, write_comparison
    from pkm_studies.sessions.next_reading import (
        Advice,
        Adviser,
        FittedReadings,
        SkippedPose,
        visit_lines,
    )
else:
    __getattr__ = door(__name__)
