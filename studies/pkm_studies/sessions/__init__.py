"""A machine after its first result: next readings, verification, acceptance, history."""
