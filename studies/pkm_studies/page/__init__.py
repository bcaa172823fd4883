"""The page at the machine: a local server of one study and its readings file."""
