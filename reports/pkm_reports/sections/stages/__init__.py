"""The chapter about a plan in stages, a part of it a module."""
