"""Units that files of the user's may use, each with its factor to SI.

Lines, trains and recordings share them, so that what one file may say any other may."""

from __future__ import annotations

KMH = 3.6
FOOT, MILE, KNOT, GRAVITY = 0.3048, 1609.344, 1852 / 3600, 9.80665
TIMES = {"s": 1.0, "sec": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0}
LENGTHS = {"m": 1.0, "km": 1e3, "cm": 1e-2, "mm": 1e-3, "ft": FOOT, "mi": MILE}
SPEEDS = {"m/s": 1.0, "mps": 1.0, "km/h": 1 / KMH, "kmh": 1 / KMH, "kph": 1 / KMH, "mph": MILE / 3600, "kn": KNOT,
          "ft/s": FOOT, "cm/s": 1e-2}
SHARES = {"-": 1.0, "share": 1.0, "%": 1e-2, "percent": 1e-2}
SLOPES = {"-": 1.0, "permil": 1e-3, "%": 1e-2}
ACCELERATIONS = {"m/s^2": 1.0, "m/s2": 1.0, "m/s²": 1.0, "mps2": 1.0, "g": GRAVITY}
ANGLES = {"deg": 1.0, "°": 1.0}
FORCES = {"kN": 1e3, "N": 1.0}
POWERS = {"kW": 1e3, "W": 1.0, "MW": 1e6}
MASSES = {"kg": 1.0, "t": 1e3}
