"""RBPF, SMA and GSMA (Zheng, Han, Kong, Wang 2015): `estimators.py` has the plug-ins.

`cloud.py` holds the particles, `full.py` and `factorised.py` the two forms of a step, `gain.py` what all particles of a
factorised step share, `select.py` pruning and resampling, `transition.py` where a parameter may go."""
