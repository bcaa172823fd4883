"""A CasADi function as operations on whole arrays of poses: graph, packing, tape, Newton."""
