"""From a study file to the objects of the kernel."""
