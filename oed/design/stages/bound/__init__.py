"""Lower bound of the goal over all plans within the budget: the certificate."""
