"""What the book shows: figures, tables and verdicts, all read from the runs' records."""
