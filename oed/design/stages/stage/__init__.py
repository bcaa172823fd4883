"""One stage of a plan: which readings, which are lost, and what is known after it."""
