"""What is to be computed: cells, plans, tasks."""
