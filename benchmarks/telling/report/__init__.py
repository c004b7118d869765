"""The report: one self-contained HTML page made from a results folder alone.

`page.py` assembles it from the overview (`matrix.py`), sections with plots and tables, and published numbers;
`page.jinja`, `page.css` and `page.js` are its looks."""

from .page import write_report

__all__ = ["write_report"]
