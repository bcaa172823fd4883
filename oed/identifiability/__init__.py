"""What readings determine: rank, combinations, information, remedies."""
