"""Estimators of other libraries behind the per-run adapter, to check ours against."""
