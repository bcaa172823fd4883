"""A CasADi function as C with vectors over poses, compiled once a computer: text, compiler, cache."""
