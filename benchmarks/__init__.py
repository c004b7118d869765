"""Running estimators on scenarios, scoring them, and telling what came out."""
