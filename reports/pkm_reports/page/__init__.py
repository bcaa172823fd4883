"""The page that a report is written on: blocks, text, style, HTML and PDF."""
