"""What Python and the command line both use: runs, results, simulated truths, lists of what there is.

`import railstate` gives the names of these modules; commands add options, printing and exit codes."""
