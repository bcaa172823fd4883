"""Library of effects as columns, and the discrepancy of unknown form."""
