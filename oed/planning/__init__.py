"""Which measurement at which stage: options of a catalogue, what a stage tells, the
search, and its bound.
"""
