"""Published numbers, one TOML file a paper, and their reproduction.

`reproduce.py` judges them, `values.py` computes what is no summary of rows, `rows.py` summarises those that are."""
