"""Observers that claim sets which surely hold the state, from bounds of the errors alone."""
