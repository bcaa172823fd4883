"""One figure a file: each module has `draw`, from a part of the result to a matplotlib
figure.
"""
