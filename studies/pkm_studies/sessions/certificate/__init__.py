"""Calibration certificates: what they state, their head as the user fills it in, XML."""
