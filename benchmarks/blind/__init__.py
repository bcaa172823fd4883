"""The blind benchmark: readings of virtual machines whose faults a diagnosis has to
name, made by code of its own.
"""
