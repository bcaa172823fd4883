"""Virtual machines with effects that a diagnosis does not know. Must import nothing of
the toolkit it is to test.
"""
