"""Optimal experiment design and uncertainty for calibrating parallel kinematic
machines.

Mathematics on a model: arrays in, frozen results out. Machines and instruments live in
`pkm_models`, studies and the command in `pkm_studies`, reports in `pkm_reports`.
"""

__version__ = "0.1.0"
