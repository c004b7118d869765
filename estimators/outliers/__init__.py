"""Filters for readings that are not what the sensor promises: gates, robust costs, heavy-tailed and adaptive noise.

All are the extended Kalman filter (or the unscented one) with another update; readings one after the other."""
