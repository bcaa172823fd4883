"""Diagnosis of the gap between model and machine: which effect, where, how far it
shrinks, what to read next.
"""
