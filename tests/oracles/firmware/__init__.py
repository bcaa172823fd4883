"""Firmwares of delta printers: their words, probing and logs, version by version.

Written from their public documentation and sources, one file each. Lengths in mm, angles
in degrees from x, counter-clockwise. Towers are in the order front left (210), front right
(330), back (90). The travel of a carriage is its way down from the switch: all that a
firmware does to a machine, whatever it believes.
"""
