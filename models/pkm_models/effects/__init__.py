"""Unmodelled effects, one a file: each module holds one `effect`. Signs and sizes are
those of machine practice.
"""
