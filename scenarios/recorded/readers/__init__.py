"""Recordings as they are: one file format a module."""
