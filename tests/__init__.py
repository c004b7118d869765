"""The tests. Before numpy is loaded: one thread for its small matrices, since pytest has several processes."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
