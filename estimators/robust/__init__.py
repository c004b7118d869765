"""The robust bounded estimators F1, F2, F3 (Liu et al. 2025): `estimators.py` has the plug-ins.

`base.py` what they share, `convex.py` their problems in cvxpy, `fast.py` (F2, F3) and `memoryless.py` (F1) the compiled
forms, `raw.py` F2's optimum where it is the measurement itself, `small.py` the algebra of one small matrix."""
