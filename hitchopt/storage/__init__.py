"""Files, written atomically and read with bounds on their size."""
