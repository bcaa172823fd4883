"""The chapters about the gap."""
