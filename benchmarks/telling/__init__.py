"""What people read, made from judgements: words, tables, figures, the report."""
