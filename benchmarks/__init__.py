"""Running estimators on scenarios, scoring them, and telling what came out."""

from ..scenarios import machine_code as machine_code  # first of all: kernels are compiled into its folder
