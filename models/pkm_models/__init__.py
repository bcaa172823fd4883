"""Mechanisms and instruments in CasADi: physics only, nothing statistical."""
