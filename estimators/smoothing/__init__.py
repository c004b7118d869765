"""Estimators of the past: what a filter knew at each event, revised by all that came after."""
