"""Estimation under random access protocols: the filter, its conditional rival, covariance bounds."""
