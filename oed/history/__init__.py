"""A machine over its sessions, and machines of one model: change, drift, a fleet's prior.

FleetPrior          parameters of a further machine of a fleet
MachineInformation  what the readings of one machine say of its parameters
MachineSessions     sessions of one machine: their change, their drift
SessionDrift        drift of all combinations over the sessions
fleet_prior         the prior of a further machine
"""

from typing import TYPE_CHECKING

from oed.base import door

if TYPE_CHECKING:
    from oed.history.fleet import FleetPrior, MachineInformation, fleet_prior
    from oed.history.sessions import MachineSessions, SessionDrift
else:
    __getattr__ = door(__name__)
