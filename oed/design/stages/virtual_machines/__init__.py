"""Virtual machines carried exactly through all stages of a plan."""
