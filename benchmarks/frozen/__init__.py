"""Numbers that a change of structure must not change, and the comparison with them."""
