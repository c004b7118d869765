"""What is simulated: settings (plants with their truths), scenario files and the design models given to estimators."""
