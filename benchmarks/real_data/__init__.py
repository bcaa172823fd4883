"""A board of real machines: what a calibration predicts of readings that it did not see."""
