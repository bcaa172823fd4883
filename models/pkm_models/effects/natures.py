"""What effects have in common: the name of a class of many."""

SCALE = "a length or a scale that is off"
TRAVEL = "an error along the travel or turn of joints"
MOTION = "an error that comes with direction or speed"
LOAD = "something that gives under load"
SESSION = "something that warms, drifts or moves during the session"
REFERENCE = "an error of a set-up's reference or instrument"

#: families of effects that differ by their form alone
REVERSAL = "a joint that stays behind its command after a reversal"
ALONG_TRAVEL = "a slow error along the travel of a joint"
