"""Figures of a results folder, drawn once on a small canvas: SVG for the report; SVG, PDF and PNG as files.

One module per family of figures; `catalogue.py` lists them all."""
