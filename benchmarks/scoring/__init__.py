"""An estimate against the truth, step by step, as the runs go; and the names of what comes out."""
