"""The figures of the gap."""
