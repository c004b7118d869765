"""What is simulated: settings (plants with their truths), scenario files and the design models given to estimators."""

from pathlib import Path

from .machine_code import key, use

_packages = Path(__file__).resolve().parent.parent
use(key(*(_packages / name for name in ("scenarios", "estimators", "benchmarks"))))
