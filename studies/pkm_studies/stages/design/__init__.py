"""The design of a plan of readings: select, polish, order, certify, score."""
