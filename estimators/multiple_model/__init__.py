"""Filters over a grid of modes that may jump: IMM, and the oracle that is told the mode."""
