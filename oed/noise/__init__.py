"""One noise model: covariance of readings, noise law, outliers, their estimation."""
