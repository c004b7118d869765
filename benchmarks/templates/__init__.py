"""The files `railstate new` writes, as Jinja templates; `commands/new.py` says which goes where.

Data of the command line: nothing here is imported."""
