"""Estimators of a train's state: one family a file, each a plug-in of the same interface."""

from ..scenarios import machine_code as machine_code  # first of all: kernels are compiled into its folder
