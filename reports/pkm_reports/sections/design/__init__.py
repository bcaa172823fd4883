"""The chapter about the chosen readings, a part of it a module with `blocks(design)`."""
