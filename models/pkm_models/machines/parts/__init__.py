"""What machines and instruments share: coordinates, legs, cables, registration."""
