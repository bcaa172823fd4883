"""Independent oracles: plain geometry that shares no code with the toolkit and must
never import it.
"""
