"""Plans of several stages: how they grow, how they are compared and refined."""
