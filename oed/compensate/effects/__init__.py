"""Corrected model: parameters and effects estimated together, and what they predict."""
