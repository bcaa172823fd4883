"""Optimal experiment design on a model of a machine: arrays in, frozen results out."""
