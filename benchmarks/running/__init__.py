"""Blocks of runs driven, scored, isolated, spread over processes and machines."""
