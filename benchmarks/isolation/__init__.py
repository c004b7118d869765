"""Processes of their own for what is not the suite's own code, with limits, and nothing of them left behind."""
