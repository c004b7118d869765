"""Constant gains with a certified mean-square bound (Zou 2018): LMIs, decay, estimators."""
