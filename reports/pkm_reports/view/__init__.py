"""What the views to turn and the linked residuals of the page are drawn from."""
