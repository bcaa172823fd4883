"""Plan of measurements in stages within a time budget.

option, goal      what can be measured, and what for
stage             one stage: its readings, and the knowledge that it leaves
sequence          plans of several stages: how they grow, how they are refined
bound             a lower bound of the goal over all plans: the certificate
virtual_machines  plans carried out exactly, to check their prediction
streams           random streams of a search
search            the search itself
"""
