"""From rows alone: statistics, summaries, verdicts."""
