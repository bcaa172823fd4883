"""Reports each run as predicted from all others: `left_out` of the section `goodness`."""

from __future__ import annotations

import msgspec

from oed.estimation.run_prediction import RunPrediction
from oed.result import GoodnessSection

#: runs that a sentence names, at most
NAMED = 3


def with_left_out(
    section: GoodnessSection, prediction: RunPrediction | None
) -> GoodnessSection:
    """The section with the runs; as it is where there is one run alone."""
    if prediction is None:
        return section
    return msgspec.structs.replace(
        section,
        left_out=list(prediction.runs),
        left_out_score=prediction.log_score,
        left_out_sd=prediction.log_score_sd,
    )


def surprises(prediction: RunPrediction | None) -> list[str]:
    """Runs that all others contradict, as one sentence; none where there are none."""
    far = () if prediction is None else prediction.surprising
    if not far:
        return []
    phrases = [
        f"run {one.run} of {one.setup} by {one.ratio:.2g} times what is predicted (p"
        f" {one.p_high:.1g})"
        for one in far[:NAMED]
    ]
    more = f", and {len(far) - NAMED} more runs" if len(far) > NAMED else ""
    return [f"all other runs contradict {', '.join(phrases)}{more}"]
