"""A results folder: parts written whole, the manifest, readers that check what they read."""
