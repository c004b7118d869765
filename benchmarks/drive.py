"""The address of `drive` that tests written by `railstate new scenario` of version 0.1 import; kept for one version."""

from .running.drive import drive as drive
