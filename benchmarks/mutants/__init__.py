"""Single-line mutations of `oed`, and whether the tests of their room detect them."""
