"""Stages of a study: one module each, from the kernel's objects to one section of the
result.
"""
