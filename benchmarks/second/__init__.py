"""The diagnosis on a second generator, which shares nothing with the blind benchmark's."""
