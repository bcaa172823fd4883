"""Published collections of readings, converted as they are read.

Each is an entry point `pkm_oed.sources`: a function from the collection's folder to rows of
a readings file, as text by column.
"""
