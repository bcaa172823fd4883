"""Parts of the chapters about the design, one a module with `blocks(design)`: nothing
where a result lacks it.
"""
