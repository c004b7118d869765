"""Estimators of a train's state: one family a file, each a plug-in of the same interface."""
