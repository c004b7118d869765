"""Loops over runs: a plan carried through to a finished folder."""
