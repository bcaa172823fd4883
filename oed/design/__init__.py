"""Design methods: one module each."""
