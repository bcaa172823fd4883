"""Benchmarks: speed beside named alternatives, and diagnosis of readings whose cause is
withheld.
"""
