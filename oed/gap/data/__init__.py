"""Residuals made ready for a diagnosis: states, signatures, metric, evidence."""
