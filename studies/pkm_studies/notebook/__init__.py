"""The steps of a study for Python users, and how results look in a notebook."""
