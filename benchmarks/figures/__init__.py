"""Figures of a results folder: drawn once on a small canvas, written as SVG for the report and as SVG, PDF or PNG files.

One module per family of figures; `catalogue.py` lists them all."""
