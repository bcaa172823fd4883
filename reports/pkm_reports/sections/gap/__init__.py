"""The chapters about the gap between model and machine."""
