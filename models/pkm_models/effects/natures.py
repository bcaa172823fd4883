"""What effects have in common: the name of a class of many."""

SCALE = "a length or a scale that is off"
TRAVEL = "an error along the travel or turn of joints"
MOTION = "an error that comes with direction or speed"
LOAD = "something that gives under load"
SESSION = "something that warms, drifts or moves during the session"
REFERENCE = "an error of a set-up's reference or instrument"
