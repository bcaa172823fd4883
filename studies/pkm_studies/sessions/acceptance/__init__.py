"""Acceptance plans of a result, and the judgement of their readings."""
