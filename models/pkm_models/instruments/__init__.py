"""Instruments: one module each, with an `instrument` attribute (and variants beside
it).
"""
