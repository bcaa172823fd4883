"""A machine over its sessions, and machines of one model: change, drift, a fleet's prior.

Cause               one parameter, or two, as all that changed
CombinationChange   change of a combination of parameters
FleetPrior          parameters of a further machine of a fleet
MachineInformation  what the readings of one machine say of its parameters
P_EXPLAINED         p-value of what causes leave, from which they explain a change
Session             posterior of the parameters after one session
SessionChange       what changed between two sessions
SessionDrift        drift of all combinations over the sessions
compare_sessions    the change between two sessions
estimate_drift      the drift over sessions
fleet_prior         the prior of a further machine
next_calibration    when an error reaches its limit
provable_growth     growth of an error that some number of sessions prove
"""

from typing import TYPE_CHECKING

from oed.base import door

if TYPE_CHECKING:
    from oed.history.fleet import FleetPrior, MachineInformation, fleet_prior
    from oed.history.sessions import (
        P_EXPLAINED,
        Cause,
        CombinationChange,
        Session,
        SessionChange,
        SessionDrift,
        compare_sessions,
        estimate_drift,
        next_calibration,
        provable_growth,
    )
else:
    __getattr__ = door(__name__)
