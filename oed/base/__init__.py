"""What knows no machine: arrays, linear algebra, smooth bases, units, text, whole files."""
